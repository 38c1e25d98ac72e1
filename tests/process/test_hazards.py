"""Cells of the hazard table with real processes: a mock of a ROS 2 robot, a bridge and a driver.

The stop button and the laser are a ROS node of their own, which may end.
"""

import threading
import time
from contextlib import closing
from functools import partial

import numpy as np
import pytest
from kit.bridge_bench import PERIOD_S, Driver, wait_for
from kit.deploy_bench import driver
from kit.hazard_table import COURSE, cells_with_processes, gate_words, page_words
from kit.peer import Peer

from bridge.ros2.discovery import Convention
from bridge.ros2.ros_node import RosNode
from deploy.drive.records import START_TOPIC
from rover_ncp.core.config import dump_yaml
from rover_ncp.core.geometry import Velocity
from rover_ncp.recording.recording import read_recording
from rover_ncp.wire.cdr import encode
from rover_ncp.wire.messages import BOOL, LASER_SCAN, laser_scan, twist_stamped
from rover_ncp.wire.protocol import CommandTag
from rover_ncp.wire.zenoh import client_config
from sim.park.live import ROS2DDS, LiveRun

MOCK = "name: mine\nbased_on: turtlebot4\ntopics: {scan: null}\n"
ROBOT = "name: mine\nbased_on: turtlebot4\ntopics: {stop: {topic: stop, latched: true}}\n"
"""As the bridge and the driver know the robot."""
FAULT_S = {"low-battery=9": 3.5}
"""How long the mock has a fault, where it is not 2 s."""
PATIENCE_S = 20.0
"""As long as a driver of the kit waits: a busy machine may be several times as slow."""


class Sensors(Peer):
    """A node with a stop button, which reports once, and a laser, which may fall silent."""

    def __init__(self, base):
        super().__init__(client_config(f"tcp/{base}", None)[0])
        self.scans = True
        self._node = RosNode(self.session, Convention.ROS2DDS, name="sensors")
        self._laser = self._node.publisher("scan", LASER_SCAN)
        self._button = self._node.publisher("stop", BOOL, latched=True)
        self._button.put(encode(BOOL, data=False))
        self._node.announce()

    def press(self, pressed=True):
        self._button.put(encode(BOOL, data=pressed))

    def run(self):
        while not self.closing.wait(0.1):
            if self.scans:
                self._laser.put(laser_scan([float("inf")] * 120, (0.15, 12.0), 0))


class Watcher(Driver):
    """Receives each status of the gate."""

    keys = ("rover/gate", "odom")

    def __init__(self, locator):
        self.statuses = []
        super().__init__(locator)

    def receive(self, name, data):
        super().receive(name, data)
        if name == "rover/gate":
            self.statuses.append(self.gate)

    def ready(self, robot):
        """Wait until nothing holds the robot, with sensors of its own and no fault any more.

        The bridge must notice that earlier sensors are gone before there are new ones: else it may forget the
        stop of the new ones with the earlier publisher, or the robot may seem ready by what the earlier sent.
        """
        time.sleep(max(0.0, robot.faulty_until_s - time.monotonic()))
        if robot.sensors is not None:
            robot.sensors.press(False)  # a pressed stop is named before an unknown one
        robot.lose_sensors()
        wait_for(lambda: self.statuses and self.gate.held == "hazard-unknown", PATIENCE_S)
        robot.sensors = Sensors(robot.base).start()
        wait_for(lambda: not self.gate.held, PATIENCE_S)
        self.statuses.clear()


class Robot(LiveRun):
    """The robot with its bridge; ``sensors`` is None until `Watcher.ready`."""

    def __init__(self, folder):
        mock, model, limits = (folder / name for name in ("mock.yaml", "robot.yaml", "limits.yaml"))
        mock.write_text(MOCK)
        model.write_text(ROBOT)
        limits.write_text("sonar_stop_m: 0.3\n")
        self.model, self.sensors, self.faulty_until_s = model, None, 0.0
        bridge = ["--model", str(model), "--limits", str(limits), "--no-base-watchdog"]
        super().__init__(
            folder / "run", mock=["--ros2", "--model", str(mock)], bridge=bridge, base_form=ROS2DDS
        )

    def silence_laser(self):
        self.sensors.scans = False

    def lose_sensors(self):
        if self.sensors is not None:
            self.sensors.close()
        self.sensors = None

    def close(self):
        self.lose_sensors()
        super().close()


@pytest.fixture(scope="module")
def robot(tmp_path_factory):
    with Robot(tmp_path_factory.mktemp("robot")) as robot:
        yield robot


def mock(robot, fault):
    seconds = FAULT_S.get(fault, 2.0)
    robot.mock.tell(f"{fault}@0-{seconds}")
    robot.faulty_until_s = time.monotonic() + seconds


FAULTS = {
    "sensors end": Robot.lose_sensors,
    "stop is pressed": lambda robot: robot.sensors.press(),
    "scans stop": Robot.silence_laser,
}
"""Faults that the mock does not have."""
CELLS = cells_with_processes()
STALE, FORGED = (CELLS.pop(name) for name in ("stale commands", "forged commands"))


STALL_S = 0.2
"""Shorter than any limit for commands and odometry: beyond it a hazard of its own may be seen."""
TRIES = 5


def judge(run, expected):
    """Assert that ``run`` finds what is expected; again if this computer stalled it for too long.

    ``run`` returns what it found, the longest time between two commands or two samples of odometry, and what
    helps to understand a failure.
    """
    for _ in range(TRIES):
        found, stalled_s, details = run()
        if found == expected or stalled_s < STALL_S:
            break
    assert found == expected, f"stalled for {stalled_s:.2f} s; {details}"


def longest_gap_s(path):
    """Return the longest time without a command, or without odometry, from a drive's start to its end.

    A drive ends when odometry is late, so the longest gap may be the one before its end.
    """
    recording = read_recording(path)
    times = {
        topic: [message.log_ns for message in recording.topic(topic)]
        for topic in (START_TOPIC, "rover/gate", "cmd_vel", "odom")
    }
    start, end = times[START_TOPIC], max(map(max, filter(None, times.values())))
    gaps = [np.diff([*start, *times["cmd_vel"], end]), np.diff([*times["odom"], end])]
    return max(gap.max(initial=0) for gap in gaps) * 1e-9


@pytest.mark.parametrize("cell", CELLS.values())
def test_gate_driver_and_page_do_as_the_table_says(robot, cell, tmp_path, capsys, monkeypatch):
    course, path = tmp_path / "wide.yaml", tmp_path / "run.mcap"
    horizon_s = 3.0 if cell["driver"] == "drives" else COURSE.horizon_s  # the less time, the fewer stalls
    course.write_text(dump_yaml(COURSE.model_dump(mode="json") | {"horizon_s": horizon_s}))
    drive = driver(robot, tmp_path, capsys, monkeypatch)
    fault = cell["process"]

    def run():
        with closing(Watcher(robot.robot)) as watcher:
            if fault == "no sensors":
                robot.lose_sensors()
            else:
                watcher.ready(robot)
            over = threading.Event()

            def inject():
                while watcher.gate.sequence <= 8:
                    if over.wait(0.005):
                        return
                FAULTS.get(fault, partial(mock, fault=fault))(robot)

            injecting = threading.Thread(target=inject)
            injecting.start()
            try:
                code, result = drive(model=str(robot.model), pose="none", course=str(course))
            finally:
                over.set()
                injecting.join()
            rule = result["stopped_by"]
            if leased := path.exists():  # else the drive had no tick; the watcher may receive its end later
                wait_for(lambda: any(status.lease for status in watcher.statuses) and not watcher.gate.lease)
            gate = gate_words(watcher.statuses) if leased else f"refuses {rule}"
        page = page_words(read_recording(path)) if leased else "no page"
        found = gate, f"stops {rule}" if code == 4 else "drives", page
        return found, longest_gap_s(path) if leased else STALL_S, (code, result)

    judge(run, (cell["gate"], cell["driver"], cell["page"]))


@pytest.mark.parametrize("cell", [STALE])
def test_gate_holds_at_stale_commands(robot, cell):
    """How soon it does is measured in test_bridge_process."""
    with closing(Watcher(robot.robot)) as driver:
        driver.ready(robot)
        driver.start(v=0.1).drive(0.5, v=0.1)

        def stop():
            driver.send(0.1, age_s=1.0)
            stops = (each for each in driver.statuses if each.held and each.sequence >= 5)
            return next(stops, None)  # the lease ends, too, a second after the last command

        assert f"holds {wait_for(stop).held}" == cell["gate"]
        wait_for(lambda: driver.send(0.1, age_s=1.0) and driver.odom.velocity.v == 0.0)


@pytest.mark.parametrize("cell", [FORGED])
def test_forged_commands_change_nothing(robot, cell):
    with closing(Watcher(robot.robot)) as driver:

        def run():
            driver.ready(robot)
            driver.start(v=0.1)
            sent_ns = []
            for _ in range(20):
                sent_ns.append(driver.send(0.1))
                payload = twist_stamped(Velocity(-0.1, 0.5), driver.time_ns())
                tag = CommandTag(driver.lease.number, driver.gate.sequence + 5, driver.now_ns)
                driver.command(payload, tag.pack())
                driver.sleep(PERIOD_S)
            moves = driver.odom.velocity == pytest.approx((0.1, 0.0), abs=0.02)
            found = gate_words(driver.statuses), moves
            driver.motors(enable=False)
            return found, max(np.diff(sent_ns)) * 1e-9, driver.gate

        judge(run, (cell["gate"], True))
