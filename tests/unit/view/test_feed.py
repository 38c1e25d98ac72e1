"""The live page among real processes: its data and its Stop button."""

import contextlib
import http.client
import json
import signal
import threading
import time
import urllib.request
from html import unescape

import pytest
from kit.recorded_drives import drive_messages
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from deploy.view import server
from deploy.view.feed import Cursor, Feed
from deploy.zenoh_client import BridgeAddress
from rover_ncp.circuit.policy_file import load_policy
from rover_ncp.core.console import Output
from rover_ncp.core.errors import NoBridge
from rover_ncp.course.course import load_course
from rover_ncp.recording.recording import Recorded
from rover_ncp.wire import messages
from rover_ncp.wire.protocol import DriverStatus, StopReply, dump_json
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
    """Put the columns of several pieces of updates together, as the page does."""
    whole = {"t": [], "x": [], "potentials": [], "setpoints": [], "odometry": []}
    for updates in parts:
        if ticks := updates.get("ticks"):
            whole["t"] += ticks["t"]
            whole["x"] += ticks["x"]
            whole["potentials"] += ticks["potentials"][3]
        whole["setpoints"] += updates.get("setpoints", {}).get("v", [])
        whole["odometry"] += updates.get("odometry", {}).get("x", [])
    return whole


def test_updates_in_pieces_are_the_whole(short):
    policy, course, received, simulated = short
    pieces, cursor, feed = [], Cursor(), Feed(policy, course)
    for number, message in enumerate(received):
        feed.take(message)
        if number % 7 == 0:
            pieces.append(json.loads(json.dumps(feed.updates(cursor), allow_nan=False)))
    pieces.append(feed.updates(cursor))
    whole, once = joined(pieces), joined([feed.updates(Cursor())])
    assert whole == once
    assert whole["x"] == pytest.approx(simulated.poses[:-1, 0], abs=1e-4)
    assert whole["potentials"] == pytest.approx(simulated.potentials[:, 3], abs=0.01)
    assert [piece["reset"] for piece in pieces].count(True) == 1
    assert pieces[-1]["status"]["state"] == "ended"
    assert "By the estimated pose" in pieces[-1]["html"]["summary"]
    assert len(pieces[-1]["findings"]["contributions"]) == 132


def test_all_findings_are_sent_at_the_end_without_a_new_tick(short):
    policy, course, received, _ = short
    cursor, feed = Cursor(), Feed(policy, course)
    on_the_way = [message for message in received if message.topic != "rover/status"]
    for message in [status("running", received[0].log_ns), *on_the_way]:
        feed.take(message)
    assert "findings" not in feed.updates(cursor)
    feed.take(status("fault", received[-1].log_ns))
    assert len(feed.updates(cursor)["findings"]["contributions"]) == 132
    assert "findings" not in feed.updates(cursor)


def test_a_new_drive_begins_anew(short):
    policy, course, received, _ = short
    feed, cursor = Feed(policy, course), Cursor()
    for message in received:
        feed.take(message)
    assert feed.updates(cursor)["ticks"]["t"]
    after = received[-1].log_ns + 10**9
    feed.take(status("armed", after))
    fresh = feed.updates(cursor)
    assert fresh["reset"] is True
    assert "ticks" not in fresh
    assert [event["text"] for event in fresh["events"]] == []
    for message in received:
        feed.take(message)
    assert len(feed.updates(cursor)["ticks"]["t"]) == course.ticks


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
    assert "neurons are not those of this page's policy" in unescape(
        feed.updates(Cursor())["html"]["subline"]
    )


class Page:
    """The server as a browser on this machine sees it."""

    def __init__(self, address):
        self.address = address
        self.host = address.removeprefix("http://").rstrip("/")

    def connect(self, origin=None):
        return connect(f"ws://{self.host}/live", origin=origin or f"http://{self.host}", open_timeout=5)

    def request(self, what):
        """Request a stop or its release, and return the answer."""
        with self.connect() as socket:
            socket.send(what)
            return json.loads(socket.recv(timeout=5))["answer"]

    def updates(self, until, timeout_s=30.0):
        """Request updates until some satisfy ``until``; return them."""
        deadline = time.monotonic() + timeout_s
        with self.connect() as socket:
            while time.monotonic() < deadline:
                socket.send("updates")
                updates = json.loads(socket.recv(timeout=5))
                if until(updates):
                    return updates
                time.sleep(0.1)
        raise AssertionError("no such updates")


class SlowFeed:
    """News that never come."""

    def __init__(self):
        self.released = threading.Event()

    def updates(self, cursor, bridge):
        self.released.wait(30)
        return {}


class CountingViewer:
    """A viewer that only counts."""

    bridge_alive = may_stop = True
    stops = 0

    def stop(self, release):
        self.stops += not release
        return StopReply(stopped=not release)


@contextlib.contextmanager
def served(feed, viewer):
    """Serve the application without a robot."""
    listener = server._listener(0)
    config = server.uvicorn.Config(
        server._application("", feed, viewer), ws="websockets-sansio", log_level="warning", lifespan="off"
    )
    running = server.uvicorn.Server(config)
    thread = threading.Thread(target=running.run, kwargs={"sockets": [listener]})
    thread.start()
    try:
        yield Page(f"http://127.0.0.1:{listener.getsockname()[1]}/")
    finally:
        feed.released.set()
        running.should_exit = True
        thread.join()


def test_stop_waits_for_no_news():
    """News of more pages than there are threads for updates, none of which comes."""
    feed, viewer = SlowFeed(), CountingViewer()
    with served(feed, viewer) as page, contextlib.ExitStack() as stack:
        sockets = [stack.enter_context(page.connect()) for _ in range(60)]
        for socket in sockets:
            socket.send("updates")
        for number, socket in enumerate(sockets, 1):
            socket.send("stop")
            assert json.loads(socket.recv(timeout=5)) == {"answer": {"stopped": True}}
            assert viewer.stops == number


def test_only_a_page_of_this_server_may_connect():
    with served(SlowFeed(), CountingViewer()) as page:
        for origin in ("http://evil.example", "null", f"https://{page.host}", None):
            with pytest.raises(InvalidStatus, match="403"):
                connect(f"ws://{page.host}/live", origin=origin)
        with pytest.raises(InvalidStatus, match="400"):
            connect(
                f"ws://{page.host}/live",
                additional_headers={"Host": "evil.example"},
                origin="http://evil.example",
            )
        with page.connect() as socket:
            for request in ("", "STOP", "x" * 16):
                socket.send(request)
            socket.send("stop")
            assert json.loads(socket.recv(timeout=5)) == {"answer": {"stopped": True}}


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
    driving = page.updates(
        lambda updates: updates.get("ticks", {}).get("t") and updates["ticks"]["t"][-1] > 5.5
    )
    assert driving["bridge"]
    assert driving["mayStop"]
    assert driving["status"]["state"] == "driving"
    assert any(event["kind"] == "start" for event in driving["events"])

    with urllib.request.urlopen(page.address, timeout=5) as answer:
        assert b'id="stop"' in answer.read()
    # A foreign page in the same browser, and a name for this machine from a foreign DNS.
    with pytest.raises(InvalidStatus, match="403"):
        page.connect("http://evil.example")
    line = http.client.HTTPConnection(page.host, timeout=5)
    line.request("GET", "/", headers={"Host": "evil.example"})
    assert line.getresponse().status == 400
    line.close()
    assert running.truth.speed() > 0.03  # so it still drives

    pressed_ns = running.truth.read()[-1].clock_ns
    assert page.request("stop") == {"stopped": True}
    assert running.truth.stood_after(pressed_ns) < 0.5
    ended = page.updates(lambda updates: updates["status"]["state"] == "fault")
    assert ended["gate"]["held"] == "stopped"
    assert ended["gate"]["stop_reason"] == "the live page's Stop button"
    assert ended["status"]["reason"] == "stopped by the live page's Stop button"

    assert page.request("release") == {"stopped": False}
    page.updates(lambda updates: updates["gate"]["held"] != "stopped")


def test_ctrl_c_ends_it_with_130_and_no_traceback_while_a_page_listens(live):
    _, running, folder = live
    logs = folder / "second"
    logs.mkdir()
    watch = Process("watch", ["--robot", running.robot, "--port", "0"], logs)
    try:
        address = watch.wait_for_line("watching at ")
        with Page(address).connect() as socket:
            socket.send("updates")
            socket.recv(timeout=5)
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
    gone = page.updates(lambda updates: not updates["bridge"])
    assert gone["mayStop"] is False
    assert "nothing to stop" in page.request("stop")["error"]
