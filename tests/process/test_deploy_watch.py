"""The live page among real processes: its data and its Stop button."""

import http.client
import json
import signal
import time
import urllib.error
import urllib.request
from html import unescape
from itertools import pairwise

import pytest
from recorded_drives import drive_messages

from deploy.report.page.feed import Feed, Place
from deploy.watch import server
from deploy.zenoh_client import BridgeAddress
from rover_ncp.circuit.policy_file import load_policy
from rover_ncp.core import messages
from rover_ncp.core.console import Output
from rover_ncp.core.errors import NoBridge
from rover_ncp.core.protocol import DriverStatus, dump_json
from rover_ncp.core.recording import Recorded
from rover_ncp.course.course import load_course
from sim.live.live_run import LiveRun
from sim.live.processes import Process

SHORT = "tests/data/short_course.yaml"


@pytest.fixture(scope="module")
def short():
    policy, course = load_policy("parking"), load_course(SHORT)
    return policy, course, *drive_messages(policy, course, truth=False)


def status(state, ns):
    return Recorded(
        "rover/status",
        "std_msgs/msg/String",
        messages.text(dump_json(DriverStatus(state=state)).decode()),
        ns,
        ns,
    )


def joined(parts):
    """Put the columns of several pieces of news together, as the page does."""
    whole = {"t": [], "x": [], "potentials": [], "letThrough": [], "odometry": []}
    for news in parts:
        if ticks := news.get("ticks"):
            whole["t"] += ticks["t"]
            whole["x"] += ticks["x"]
            whole["potentials"] += ticks["potentials"][3]
        whole["letThrough"] += news.get("letThrough", {}).get("v", [])
        whole["odometry"] += news.get("odometry", {}).get("x", [])
    return whole


def test_news_in_pieces_are_the_whole(short):
    policy, course, received, simulated = short
    pieces, place, feed = [], Place(), Feed(policy, course)
    for number, message in enumerate(received):
        feed.take(message)
        if number % 7 == 0:
            pieces.append(json.loads(json.dumps(feed.news(place), allow_nan=False)))
    pieces.append(feed.news(place))
    whole, once = joined(pieces), joined([feed.news(Place())])
    assert whole == once
    assert whole["x"] == pytest.approx(simulated.poses[:-1, 0], abs=1e-4)
    assert whole["potentials"] == pytest.approx(simulated.potentials[:, 3], abs=0.01)
    assert [piece["reset"] for piece in pieces].count(True) == 1
    assert pieces[-1]["status"]["state"] == "ended"
    assert "By the estimated pose" in pieces[-1]["html"]["summary"]
    assert len(pieces[-1]["findings"]["contributions"]) == 132


def test_phases_are_sent_during_the_drive_at_most_once_a_second(short):
    policy, course, received, _ = short
    now, place, found = [0.0], Place(), []
    feed = Feed(policy, course, clock=lambda: now[0])
    for message in received:
        feed.take(message)
        if message.topic == "rover/neurons":
            now[0] += 0.1
            news = feed.news(place)
            if "findings" in news:
                found.append((now[0], news["findings"]))
    times = [t for t, _ in found]
    assert len(times) >= 3
    assert all(b - a >= 0.99 for a, b in pairwise(times))
    assert set(found[0][1]) == {"phases"}


def test_all_findings_are_sent_at_the_end_without_a_new_tick(short):
    policy, course, received, _ = short
    place, feed = Place(), Feed(policy, course)
    on_the_way = [message for message in received if message.topic != "rover/status"]
    for message in [status("running", received[0].log_ns), *on_the_way]:
        feed.take(message)
    assert set(feed.news(place)["findings"]) == {"phases"}
    feed.take(status("fault", received[-1].log_ns))
    assert len(feed.news(place)["findings"]["contributions"]) == 132
    assert "findings" not in feed.news(place)


def test_a_new_drive_begins_anew(short):
    policy, course, received, _ = short
    feed, place = Feed(policy, course), Place()
    for message in received:
        feed.take(message)
    assert feed.news(place)["ticks"]["t"]
    after = received[-1].log_ns + 10**9
    feed.take(status("armed", after))
    fresh = feed.news(place)
    assert fresh["reset"] is True
    assert "ticks" not in fresh
    assert [event["text"] for event in fresh["events"]] == []
    for message in received:
        feed.take(message)
    assert len(feed.news(place)["ticks"]["t"]) == course.ticks


@pytest.mark.parametrize(("model", "corners"), [("p3at-sh", 5), ("turtlebot4", 37)])
def test_the_page_draws_the_robots_own_outline(short, monkeypatch, model, corners):
    drawn = []
    monkeypatch.setattr(server, "watch_page", lambda *parts: drawn.append(parts[-1]))
    with pytest.raises(NoBridge):
        server.run(BridgeAddress("tcp/127.0.0.1:9"), "parking", SHORT, 0, Output(False), model=model)
    assert len(drawn[0]) == corners


def test_waiting_for_a_drive_costs_no_memory(short):
    policy, course, received, _ = short
    feed = Feed(policy, course)
    sample = next(message for message in received if message.topic == "odom")
    for _ in range(1000):
        feed.take(sample)
    assert len(feed._timeline.odometry) <= 50


def test_neurons_of_another_policy_are_noticed(short):
    policy, course, _, _ = short
    feed = Feed(policy, course)
    feed.take(
        Recorded("rover/neurons", "std_msgs/msg/Float64MultiArray", messages.neurons([0.0], ["X"]), 1, 1)
    )
    assert "neurons are not those of this page's policy" in unescape(feed.news(Place())["html"]["subline"])


class Page:
    """The server as a browser on this machine sees it."""

    def __init__(self, address):
        self.address = address
        self.host = address.removeprefix("http://").rstrip("/")

    def post(self, what, origin):
        headers = {"Origin": origin} if origin else {}
        request = urllib.request.Request(self.address + what, method="POST", headers=headers)
        try:
            with urllib.request.urlopen(request, timeout=5) as answer:
                return answer.status, json.load(answer)
        except urllib.error.HTTPError as error:
            with error:
                return error.code, json.loads(error.read())

    def news(self, until, timeout_s=30.0):
        """Read events until one satisfies ``until``; return it."""
        deadline = time.monotonic() + timeout_s
        with urllib.request.urlopen(self.address + "events", timeout=5) as stream:
            for line in stream:
                if line.startswith(b"data: "):
                    news = json.loads(line[6:])
                    if until(news):
                        return news
                assert time.monotonic() < deadline, "no matching event"
        raise AssertionError("the stream ended")


@pytest.fixture(scope="module")
def live(tmp_path_factory):
    """A rover that drives the parking course, while this machine watches."""
    folder = tmp_path_factory.mktemp("live")
    with LiveRun(folder) as running:
        watch = Process("watch", ["--robot", running.robot, "--port", "0"], folder)
        running.processes.append(watch)
        page = Page(watch.wait_for_line("watching at "))
        running.deploy("--record", str(folder / "run.mcap"))
        yield page, running, folder


def test_the_stop_button_stops_a_running_rover(live):
    page, running, _ = live
    driving = page.news(lambda news: news.get("ticks", {}).get("t") and news["ticks"]["t"][-1] > 5.5)
    assert driving["bridge"]
    assert driving["mayStop"]
    assert driving["status"]["state"] == "driving"
    assert any(event["kind"] == "start" for event in driving["events"])

    with urllib.request.urlopen(page.address, timeout=5) as answer:
        assert b'id="stop"' in answer.read()
    # A foreign page in the same browser, and a name for this machine from a foreign DNS.
    assert page.post("stop", "http://evil.example")[0] == 403
    assert page.post("stop", None)[0] == 403
    line = http.client.HTTPConnection(page.host, timeout=5)
    line.request("GET", "/", headers={"Host": "evil.example"})
    assert line.getresponse().status == 400
    line.close()
    assert running.truth.speed() > 0.03  # so it still drives

    pressed_ns = running.truth.read()[-1].clock_ns
    code, said = page.post("stop", page.address.rstrip("/"))
    assert (code, said["stopped"]) == (200, True)
    assert running.truth.stood_after(pressed_ns) < 0.5
    ended = page.news(lambda news: news["status"]["state"] == "fault")
    assert ended["gate"]["held"] == "stopped"
    assert "the Stop button of a viewer" in ended["gate"]["stop_reason"]

    code, said = page.post("release", page.address.rstrip("/"))
    assert (code, said["stopped"]) == (200, False)
    page.news(lambda news: news["gate"]["held"] != "stopped")


def test_ctrl_c_ends_it_with_130_and_no_traceback_while_a_page_listens(live):
    _, running, folder = live
    logs = folder / "second"
    logs.mkdir()
    watch = Process("watch", ["--robot", running.robot, "--port", "0"], logs)
    try:
        address = watch.wait_for_line("watching at ")
        with urllib.request.urlopen(address + "events", timeout=5) as stream:
            stream.readline()
            watch.send_signal(signal.SIGINT)
            done = watch.wait(30)
    finally:
        watch.stop()
    assert done.code == 130
    assert done.result["address"] == address
    assert (logs / "watch.log").read_text() == f"watching at {address}\n"


def test_the_end_of_the_bridge_is_reported(live):
    page, running, _ = live
    running.bridge.stop()
    gone = page.news(lambda news: not news["bridge"])
    assert gone["mayStop"] is False
    code, said = page.post("stop", page.address.rstrip("/"))
    assert code == 502
    assert "nothing to stop" in said["error"]
