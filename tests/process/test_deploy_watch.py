"""The live page: its Stop button and its end as a process, and while updates are slow."""

import contextlib
import json
import signal
import socket
import threading
import time
import urllib.request
from types import SimpleNamespace

import pytest
from kit.bridge_bench import Driver
from websockets.sync.client import connect

from deploy.view import server
from rover_ncp.wire.messages import text
from rover_ncp.wire.protocol import DriverStatus, StopReply, dump_json
from sim.park.live import Process


class Page:
    """The server as a browser on this machine sees it."""

    def __init__(self, address):
        self.address = address
        self.host = address.removeprefix("http://").rstrip("/")

    def connect(self, origin=None):
        return connect(f"ws://{self.host}/live", origin=origin or f"http://{self.host}", open_timeout=5)

    def reads_nothing(self):
        """Return the TCP connection of a WebSocket, of which nothing more is read by itself."""
        connection = socket.create_connection(self.host.split(":"))
        headers = {"Host": self.host, "Origin": f"http://{self.host}", "Upgrade": "websocket"}
        headers |= {
            "Connection": "Upgrade",
            "Sec-WebSocket-Version": "13",
            "Sec-WebSocket-Key": 22 * "A" + "==",
        }
        lines = ["GET /live HTTP/1.1", *(f"{name}: {value}" for name, value in headers.items()), "", ""]
        connection.sendall("\r\n".join(lines).encode())
        connection.recv(4096)
        return connection

    def request(self, what):
        """Request a stop or its release, and return the answer."""
        with self.connect() as page:
            page.send(what)
            return json.loads(page.recv(timeout=5))["answer"]

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


@contextlib.contextmanager
def served(updates, stop):
    """Serve pages whose updates and stops are these functions; yield the server as a browser sees it."""
    viewer = SimpleNamespace(bridge_alive=True, may_stop=True, stop=stop)
    application = server._application("", SimpleNamespace(updates=updates), viewer)
    listener, running = server._listener(0), server._server(application)
    thread = threading.Thread(target=running.run, kwargs={"sockets": [listener]})
    thread.start()
    try:
        yield Page(f"http://127.0.0.1:{listener.getsockname()[1]}/")
    finally:
        running.should_exit = True
        thread.join()


def test_stop_waits_for_no_news():
    """Updates of more pages than there are threads for them, none of which comes."""
    released, stops = threading.Event(), []

    def stop(release):
        stops.append(release)
        return StopReply(stopped=not release)

    with (
        served(lambda cursor, bridge: released.wait(30) and {}, stop) as page,
        contextlib.ExitStack() as stack,
    ):
        stack.callback(released.set)
        sockets = [stack.enter_context(page.connect()) for _ in range(60)]
        for socket in sockets:
            socket.send("updates")
        for number, socket in enumerate(sockets, 1):
            socket.send("stop")
            assert json.loads(socket.recv(timeout=5)) == {"answer": {"stopped": True}}
            assert stops == [False] * number


def test_little_waits_for_a_page_that_takes_nothing_and_then_it_is_closed(monkeypatch):
    monkeypatch.setattr(server, "SLOW_S", 0.5)
    made = []

    def updates(cursor, bridge):
        made.append("x" * 500_000)
        return {"news": made[-1]}

    with served(updates, None) as page:
        with page.reads_nothing() as slow:
            slow.sendall(500 * b"\x81\x87\0\0\0\0updates")
            time.sleep(1.0)
            assert len(made) < 50
            slow.settimeout(5)
            with pytest.raises(ConnectionError):
                while True:
                    slow.sendall(b"\x8a\x80\0\0\0\0")
                    time.sleep(0.01)
        with page.connect() as quick:
            quick.send("updates")
            assert quick.recv(timeout=5)


def test_page_stops_a_driven_rover_reports_the_end_of_the_bridge_and_ends_at_ctrl_c(bridge, tmp_path):
    """The drive of a circuit is watched and stopped in tests/system/test_browser.py."""
    options = ["--robot", bridge.robot, "--port", "0"]
    with Process("watch", options, tmp_path) as watch, Driver(bridge.robot) as driver:
        page = Page(watch.wait_for_line("watching at "))
        driver.start()
        driver.session.put("rover/status", text(dump_json(DriverStatus(state="driving")).decode()))
        driving = page.updates(lambda updates: updates["status"] and driver.send())
        assert (driving["bridge"], driving["mayStop"]) == (True, True)
        assert driving["status"]["state"] == "driving"
        with urllib.request.urlopen(page.address, timeout=5) as answer:
            assert b'id="stop"' in answer.read()

        driver.start()
        assert page.request("stop") == {"stopped": True}
        driver.drive(0.8)
        assert bridge.rover.velocity.v == 0.0
        stopped = page.updates(lambda updates: updates["gate"]["held"] == "stopped")
        assert stopped["gate"]["stop_reason"] == "the live page's Stop button"
        assert page.request("release") == {"stopped": False}
        page.updates(lambda updates: updates["gate"]["held"] != "stopped")

        bridge.close()
        gone = page.updates(lambda updates: not updates["bridge"])
        assert gone["mayStop"] is False
        assert "nothing to stop" in page.request("stop")["error"]

        for other in ({"message": b"\xff\xfe", "text": True}, {"message": b"stop"}):
            with page.connect() as opened:
                opened.send(**other)

        with page.connect():
            watch.send_signal(signal.SIGINT)
            done = watch.wait(30)
        assert done.code == 130
        assert done.result["address"] == page.address
        assert (tmp_path / "watch.log").read_text() == f"watching at {page.address}\n"
