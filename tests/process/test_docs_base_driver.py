"""The base driver of docs/base_driver.md, installed as a package of its own, drives a robot of JSON lines."""

import contextlib
import json
import re
import socket
import threading
import time

import pytest
from kit.bridge_bench import Driver, wait_for
from kit.paths import ROOT

from rover_ncp import cli
from rover_ncp.wire.protocol import BaseReply, parse_json
from sim.live.processes import Process

PAGE = (ROOT / "docs" / "base_driver.md").read_text()


class JsonRobot:
    """A robot that does what its last line says, on a socket of its own."""

    def __init__(self):
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port = self._listener.getsockname()[1]
        self.v = self.x = 0.0
        self.thread = threading.Thread(target=self._serve, daemon=True)
        self.thread.start()

    def _serve(self):
        with self._listener:
            line, _ = self._listener.accept()
        taking = threading.Thread(target=self._take, args=(line,), daemon=True)
        taking.start()
        with line:
            while True:
                self.x += 0.05 * self.v
                state = {"x": self.x, "y": 0.0, "theta": 0.0, "v": self.v, "omega": 0.0}
                try:
                    line.sendall(json.dumps(state).encode() + b"\n")
                except OSError:
                    break
                time.sleep(0.05)
            taking.join()

    def _take(self, line):
        with line.makefile("rb") as lines, contextlib.suppress(OSError):
            for command in lines:
                self.v = json.loads(command)["v"]


@pytest.fixture(autouse=True)
def package(tmp_path, monkeypatch):
    """The page's module and its entry point where Python finds them, as an installer leaves them."""
    code = re.search(r'```python title="json_base.py"\n(.*?)```', PAGE, re.DOTALL).group(1)
    (tmp_path / "json_base.py").write_text(code)
    entry = re.search(r'(json = "(json_base:JsonBase)")', PAGE).group(2)
    info = tmp_path / "json_base-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: json-base\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(f"[rover_ncp.bases]\njson = {entry}\nbroken = json_base:Missing\n")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    monkeypatch.syspath_prepend(tmp_path)


def options(base, model):
    return ["--base", base, "--model", model, "--listen", "tcp/127.0.0.1:0"]


def test_a_driver_of_another_package_drives_its_robot(tmp_path):
    robot = JsonRobot()
    with (
        Process("bridge", options(f"json/127.0.0.1:{robot.port}", "turtlebot4"), tmp_path) as bridge,
        Driver(bridge.wait_for_line("ready zenoh=").split()[0]) as driver,
    ):
        assert parse_json(BaseReply, driver.query("rover/base", b"{}")).model == "turtlebot4"
        driver.start(v=0.3).drive(0.5, v=0.9)
        assert robot.v == pytest.approx(0.3)  # the gate's default, below the robot's 0.31 m/s
        assert driver.odom.pose.x == pytest.approx(robot.x, abs=0.1)
        wait_for(lambda: robot.v == 0.0)  # no command arrives any more
    robot.thread.join(5)


@pytest.mark.parametrize(
    ("base", "model", "code"),
    [("json/127.0.0.1:1", "turtlebot4", 3), ("json/127.0.0.1:1", "auto", 2), ("broken/x", "turtlebot4", 2)],
)
def test_a_driver_that_cannot_open_its_base_ends_the_bridge(base, model, code):
    assert cli.run(["bridge", *options(base, model)]) == code
