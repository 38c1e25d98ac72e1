"""The base driver of docs/base_driver.md, installed as a package of its own, drives a robot of JSON lines."""

import contextlib
import json
import os
import re
import socket
import subprocess
import sys
import threading
import time

import pytest
from kit.paths import ROOT

from deploy.drive.zenoh_link import ZenohLink
from deploy.zenoh_client import BridgeAddress
from rover_ncp import cli
from rover_ncp.core.geometry import Velocity
from rover_ncp.wire.messages import read_odometry
from sim.live.processes import wait_for

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


@pytest.fixture
def packages(tmp_path):
    """A folder with the page's module and its entry point, as an installer leaves them."""
    code = re.search(r'```python title="json_base.py"\n(.*?)```', PAGE, re.DOTALL).group(1)
    (tmp_path / "json_base.py").write_text(code)
    entry = re.search(r'(json = "(json_base:JsonBase)")', PAGE).group(2)
    info = tmp_path / "json_base-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: json-base\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(f"[rover_ncp.bases]\njson = {entry}\nbroken = json_base:Missing\n")
    return {**os.environ, "PYTHONPATH": str(tmp_path)}


def bridge(packages, base, *options):
    command = [sys.executable, "-m", "rover_ncp", "bridge", "--base", base, "--listen", "tcp/127.0.0.1:0"]
    return subprocess.Popen([*command, *options], env=packages, stdout=subprocess.PIPE, text=True)


def test_a_driver_of_another_package_drives_its_robot(packages):
    robot, odometry = JsonRobot(), []
    served = bridge(packages, f"json/127.0.0.1:{robot.port}", "--model", "turtlebot4")
    try:
        ready = next(line for line in served.stdout if line.startswith("ready "))
        where = ready.split("zenoh=")[1].split()[0]

        def record(message):
            if message.topic == "odom":
                odometry.append(read_odometry(message.data))

        with ZenohLink(BridgeAddress(where), record) as link:
            wait_for(lambda: link.bridge_alive and odometry)
            assert link.about_base().model == "turtlebot4"
            link.request_motors("test")
            for _ in range(100):
                link.command(Velocity(0.9, 0.0))  # the gate gives no more than the robot's own limit
                time.sleep(0.05)
                if odometry[-1].pose.x > 0.03 and robot.v == pytest.approx(0.3):
                    break
            assert robot.v == pytest.approx(0.3)  # the gate's default, below the robot's 0.31 m/s
            assert odometry[-1].pose.x == pytest.approx(robot.x, abs=0.1)
            wait_for(lambda: robot.v == 0.0)  # no command arrives any more
    finally:
        served.terminate()
        served.communicate(timeout=10)
        robot.thread.join(5)


@pytest.mark.parametrize(
    ("base", "model", "code"),
    [("json/127.0.0.1:1", "turtlebot4", 3), ("json/127.0.0.1:1", "auto", 2), ("broken/x", "turtlebot4", 2)],
)
def test_a_driver_that_cannot_open_its_base_ends_the_bridge(packages, monkeypatch, base, model, code):
    monkeypatch.syspath_prepend(packages["PYTHONPATH"])
    assert cli.run(["bridge", "--base", base, "--model", model, "--listen", "tcp/127.0.0.1:0"]) == code
