"""The live page: its Stop button among real processes, and while updates are slow."""

import contextlib
import json
import signal
import threading
import time
import urllib.request

from kit.paths import DATA
from websockets.sync.client import connect

from deploy.view import server
from rover_ncp.wire.protocol import StopReply
from sim.live.live_run import LiveRun
from sim.live.processes import Process

PROMPT = str(DATA / "prompt_course.yaml")


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


def test_page_stops_a_running_rover_reports_the_end_of_the_bridge_and_ends_at_ctrl_c(tmp_path):
    with LiveRun(tmp_path) as running:
        drive = ("--policy", "parking", "--course", PROMPT)
        command = ["--robot", running.robot, "--port", "0", *drive]
        watch = running.start_process(lambda: Process("watch", command, tmp_path))
        running.deploy(*drive)
        page = Page(watch.wait_for_line("watching at "))
        driving = page.updates(lambda updates: updates["status"] and running.truth.speed() > 0.03)
        assert driving["bridge"]
        assert driving["mayStop"]
        assert driving["status"]["state"] == "driving"
        assert any(event["kind"] == "start" for event in driving["events"])
        with urllib.request.urlopen(page.address, timeout=5) as answer:
            assert b'id="stop"' in answer.read()

        pressed_ns = running.truth.read()[-1].clock_ns
        assert page.request("stop") == {"stopped": True}
        assert running.truth.stood_after(pressed_ns) < 0.5
        ended = page.updates(lambda updates: updates["status"]["state"] == "fault")
        assert ended["gate"]["held"] == "stopped"
        assert ended["gate"]["stop_reason"] == "the live page's Stop button"
        assert ended["status"]["reason"] == "stopped by the live page's Stop button"
        assert page.request("release") == {"stopped": False}
        page.updates(lambda updates: updates["gate"]["held"] != "stopped")

        running.bridge.stop()
        gone = page.updates(lambda updates: not updates["bridge"])
        assert gone["mayStop"] is False
        assert "nothing to stop" in page.request("stop")["error"]

        with page.connect():
            watch.send_signal(signal.SIGINT)
            done = watch.wait(30)
        assert done.code == 130
        assert done.result["address"] == page.address
        assert (tmp_path / "watch.log").read_text() == f"watching at {page.address}\n"
