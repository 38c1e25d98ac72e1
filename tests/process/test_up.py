"""``rover-ncp up`` and ``stop`` with a mock robot: what the rover does, and what is left, at each end."""

import os
import pty
import signal
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

import psutil
import pytest
from kit.bridge_bench import Driver, wait_for

from deploy.zenoh_client import BridgeAddress, ZenohClient
from rover_ncp import cli
from rover_ncp.core.config import dump_yaml
from rover_ncp.core.geometry import ORIGIN
from sim.camera.server import MockCamera
from sim.mock.ros2_server import free_port
from sim.park.live import Process
from sim.park.truth import TruthReader

STOPPED_S = 3.0
"""A rover at 0.15 m/s stands so long after any fault here: at most the 2 s of the watchdog, and braking."""


IN_TERMINAL = """
import fcntl, os, sys, termios
fcntl.ioctl(0, termios.TIOCSCTTY, 0)
os.execv(sys.executable, [sys.executable, "-m", "rover_ncp", "up", "--robot", sys.argv[1]])
"""
"""Run ``up`` as the program of the terminal that is its standard input."""


class Robot:
    """A folder with robot.yaml for a mock Pioneer, and the processes that a test starts."""

    def __init__(self, folder, **settings):
        self.folder, self.file = folder, folder / "robot.yaml"
        (folder / "mock").mkdir()
        mock = ["--listen", "127.0.0.1:0", "--truth", str(folder / "truth.csv"), "--fault", "-"]
        self.mock = Process("mock", mock, folder / "mock", reads_lines=True)
        self.processes = [self.mock]
        self.base = f"tcp/{self.mock.wait_for_line('listening on ')}"
        self.bridge = f"tcp/127.0.0.1:{free_port('127.0.0.1')}"
        self.write(page=None, **settings)
        self.truth = TruthReader(folder / "truth.csv")

    def write(self, **settings):
        self.file.write_text(dump_yaml({"base": self.base, "bridge": self.bridge} | settings))

    def write_camera(self, source, **settings):
        for path in self.camera_files:
            path.write_text((Path(cli.__file__).parent / "data" / "dock" / path.name).read_text())
        self.write(camera={"source": source, "file": "camera.yaml"}, tags="tags.yaml", **settings)

    @property
    def camera_files(self):
        return self.folder / "camera.yaml", self.folder / "tags.yaml"

    def up(self, name="up", ready=True):
        (self.folder / name).mkdir()
        process = Process("up", ["--robot", str(self.file)], self.folder / name)
        self.processes.append(process)
        if ready:
            process.wait_for_line("bridge    ready")
        return process

    def driving(self, name="test"):
        driver = Driver(self.bridge)
        driver.name = name
        driver.start()
        driver.drive(1.0)
        assert self.speed() > 0.1
        return driver

    def speed(self):
        return abs(self.truth.read()[-1].velocity.v)

    def stands(self):
        """Wait until the true rover stands."""
        return wait_for(lambda: self.speed() < 0.005, STOPPED_S, "a standstill")

    def close(self):
        for process in reversed(self.processes):
            process.stop()


@pytest.fixture
def robot(tmp_path):
    robot = Robot(tmp_path)
    yield robot
    robot.close()


def children_of(process):
    return psutil.Process(process.pid).children(recursive=True)


def gone(children):
    """Whether none of these processes runs any more."""
    return wait_for(lambda: not any(child.is_running() for child in children), 10.0, "the end of all")


def lines_of(process):
    return "\n".join(process._lines_that_begin(""))


def test_a_closed_terminal_stops_the_rover_and_leaves_no_process(robot):
    ours, theirs = pty.openpty()
    up = subprocess.Popen(
        [sys.executable, "-c", IN_TERMINAL, str(robot.file)],
        stdin=theirs,
        stdout=theirs,
        stderr=theirs,
        start_new_session=True,
    )
    os.close(theirs)
    try:
        log = robot.folder / "logs" / "bridge.log"
        wait_for(lambda: log.exists() and "ready" in log.read_text(), 20.0)
        children = children_of(up)
        with robot.driving():
            os.close(ours)
            robot.stands()
            up.wait(10.0)  # its exit code says that its output cannot be written
        assert gone(children)
    finally:
        up.kill()
        up.wait()


def test_page_and_localiser_start_again_and_a_killed_bridge_ends_all(robot):
    """The page is killed once. The camera is unplugged while the rover drives, and comes back."""
    listen, poses = ("127.0.0.1", free_port("127.0.0.1")), []
    robot.write_camera("http://{}:{}/".format(*listen), page=0)
    plugged = partial(MockCamera, *robot.camera_files, listen, 10.0, 1)

    def sends_poses(camera):
        camera.show(ORIGIN, time.time_ns())
        return "pose" in poses

    with plugged() as camera:
        up = robot.up()
        client = ZenohClient(BridgeAddress(robot.bridge), lambda row, data: poses.append(row.name))
        wait_for(lambda: sends_poses(camera), 40.0, "poses")
        up.wait_for_line("page      watching")
        next(child for child in children_of(up) if "watch" in child.cmdline()).kill()
        assert "starts again" in up.wait_for_line("page      killed by SIGKILL")
    with client, robot.driving() as driver:
        for _ in range(40):
            driver.drive(0.5)
            assert robot.speed() > 0.1
            if "localiser ended with 2: camera " in lines_of(up):
                break
        poses.clear()
        with plugged() as camera:
            wait_for(lambda: sends_poses(camera), 40.0, "poses of the camera that is back")
            wait_for(lambda: "(restart" in lines_of(up), 20.0)
        assert lines_of(up).count("localiser ended") == 1
        driver.start()
        children = children_of(up)
        next(child for child in children if "bridge" in child.cmdline()).kill()
        robot.stands()
        done = up.wait(10.0)
    assert done.code == 3
    assert "killed by SIGKILL" in done.result["bridge"]
    assert (done.result["restarts"]["page"], done.result["restarts"]["localiser"] >= 1) == (1, True)
    assert gone(children)


def test_a_second_up_is_refused_stop_holds_a_driven_rover_and_ctrl_c_ends_all(robot, run_json):
    up = robot.up()
    children = children_of(up)
    second = robot.up("second", ready=False).wait(20.0)
    assert (second.code, up.running) == (2, True)
    assert f"process {up.pid}" in second.last_line
    with robot.driving() as driver:
        code, heard = run_json(f"stop --robot {robot.file}")
        assert (code, heard["confirmed"], heard["stands"]) == (0, True, True)
        assert robot.speed() < 0.005
        assert driver.motors().reason == "stopped"
        assert run_json(f"stop --release --robot {robot.file}")[0] == 0
        driver.start()
        up.send_signal(signal.SIGINT)
        robot.stands()
        assert up.wait(10.0).code == 130
    assert gone(children)


def test_a_stop_without_confirmation_is_not_called_one(run_json):
    code, heard = run_json(f"stop --robot tcp/127.0.0.1:{free_port('127.0.0.1')}")
    assert (code, heard["confirmed"], heard["stands"]) == (1, False, None)
    assert "nothing answers" in heard["problem"]


def test_a_docking_that_a_silent_line_ended_resumes_and_a_killed_up_leaves_a_rover_that_stands(robot):
    robot.write(page=None, resume=True)
    up = robot.up()
    with robot.driving(name="docking at home") as driver:
        robot.mock.tell("mute@0-1.5")
        driver.drive(1.0)
        assert "resumes in 5 s (1 of 3)" in up.wait_for_line("bridge    the base sends packets again", 20.0)
    assert "home.yaml: no such file" in up.wait_for_line("docking   ended with 2", 20.0)
    assert up.stop().result["resumed"] == 1
