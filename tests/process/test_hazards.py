"""Cells of the hazard table with real processes: a mock of a ROS 2 robot, a bridge and a driver.

The stop button and the laser are a ROS node of their own, which may end.
"""

import threading
from contextlib import closing
from functools import partial

import pytest
from kit.bridge_bench import PERIOD_S, Driver, wait_for
from kit.deploy_bench import driver
from kit.hazard_table import COURSE, cells_with_processes, gate_words, page_words

from bridge.ros2.discovery import Convention
from bridge.ros2.ros_node import RosNode
from rover_ncp.core.config import dump_yaml
from rover_ncp.core.geometry import STANDSTILL, Pose, Velocity
from rover_ncp.wire.cdr import encode
from rover_ncp.wire.messages import BOOL, LASER_SCAN, laser_scan, odometry, text, twist_stamped
from rover_ncp.wire.protocol import CommandTag, GateStatus, dump_json
from rover_ncp.wire.zenoh import client_config
from sim.live.live_run import ROS2DDS, LiveRun
from sim.live.peers import Peer

MOCK = "name: mine\nbased_on: turtlebot4\ntopics: {scan: null}\n"
ROBOT = "name: mine\nbased_on: turtlebot4\ntopics: {stop: {topic: stop, latched: true}}\n"
"""As the bridge and the driver know the robot."""
FAULT_S = 4.0
OF_PEER = "of a false peer"


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

    def press(self):
        self._button.put(encode(BOOL, data=True))

    def run(self):
        while not self.closing.wait(0.1):
            if self.scans:
                self._laser.put(laser_scan([float("inf")] * 120, (0.15, 12.0), 0))


class FalsePeer(Peer):
    """Sends a message of the bridge beside it, again and again."""

    def __init__(self, locator, name, data):
        super().__init__(client_config(locator, None)[0])
        self._name, self._data = name, data

    def run(self):
        while not self.closing.wait(0.05):
            self.session.put(self._name, self._data)


class Watcher(Driver):
    """Receives each status of the gate."""

    keys = ("rover/gate", "odom")

    def __init__(self, locator):
        self.statuses = []
        super().__init__(locator)

    def receive(self, name, data):
        before = self.gate
        super().receive(name, data)
        if self.gate.ended_detail == OF_PEER:
            self.gate = before
        elif name == "rover/gate":
            self.statuses.append(self.gate)

    def ready(self):
        """Wait until nothing holds the robot, also no fault of a test before this one."""
        wait_for(lambda: self.statuses and not self.gate.held)
        self.statuses.clear()


class Robot(LiveRun):
    """The robot with its bridge; ``sensors`` is None until `sense`."""

    def __init__(self, folder):
        mock, model, limits = (folder / name for name in ("mock.yaml", "robot.yaml", "limits.yaml"))
        mock.write_text(MOCK)
        model.write_text(ROBOT)
        limits.write_text("sonar_stop_m: 0.3\n")
        self.model, self.sensors, self.peer = model, None, None
        bridge = ["--model", str(model), "--limits", str(limits), "--no-base-watchdog"]
        super().__init__(
            folder / "run", mock=["--ros2", "--model", str(mock)], bridge=bridge, base_form=ROS2DDS
        )

    def sense(self):
        """Have sensors without a fault, and no false peer."""
        self.lose_sensors()
        self.sensors = Sensors(self.base).start()

    def silence_laser(self):
        self.sensors.scans = False

    def let_peer_send(self, name, data):
        self.peer = FalsePeer(self.robot, name, data).start()

    def lose_sensors(self):
        for peer in (self.sensors, self.peer):
            if peer is not None:
                peer.close()
        self.sensors = self.peer = None

    def close(self):
        self.lose_sensors()
        super().close()


@pytest.fixture(scope="module")
def robot(tmp_path_factory):
    with Robot(tmp_path_factory.mktemp("robot")) as robot:
        yield robot


def mock(robot, fault):
    robot.mock.tell(f"{fault}@0-{FAULT_S}")


FAULTS = {
    "sensors end": Robot.lose_sensors,
    "stop is pressed": lambda robot: robot.sensors.press(),
    "scans stop": Robot.silence_laser,
    "odometry of a peer": lambda robot: robot.let_peer_send(
        "odom", odometry(Pose(9.0, 9.0, 1.0), STANDSTILL, 1)
    ),
    "gate of a peer": lambda robot: robot.let_peer_send(
        "rover/gate", text(dump_json(GateStatus(ended="bumper", ended_detail=OF_PEER)).decode())
    ),
}
"""Faults that the mock does not have."""
CELLS = cells_with_processes()
STALE, FORGED = (CELLS.pop(name) for name in ("stale commands", "forged commands"))


@pytest.mark.parametrize("cell", CELLS.values())
def test_gate_driver_and_page_do_as_the_table_says(robot, cell, tmp_path, capsys, monkeypatch):
    fault = cell["process"]
    with closing(Watcher(robot.robot)) as watcher:
        if fault == "no sensors":
            robot.lose_sensors()
        else:
            robot.sense()
            watcher.ready()

            def inject():
                wait_for(lambda: watcher.gate.sequence > 8)
                FAULTS.get(fault, partial(mock, fault=fault))(robot)

            threading.Thread(target=inject, daemon=True).start()
        course = tmp_path / "wide.yaml"
        course.write_text(dump_yaml(COURSE.model_dump(mode="json")))
        drive = driver(robot, tmp_path, capsys, monkeypatch)
        code, result = drive(model=str(robot.model), pose="none", course=str(course))
        rule = result["stopped_by"]
        leased = any(status.lease for status in watcher.statuses)
        gate = gate_words(watcher.statuses) if leased else f"refuses {rule}"
    page = page_words(tmp_path / "run.mcap")
    assert (gate, f"stops {rule}" if code == 4 else "drives", page) == (
        cell["gate"],
        cell["driver"],
        cell["page"],
    )


@pytest.mark.parametrize("cell", [STALE])
def test_gate_holds_at_stale_commands(robot, cell):
    """How soon it does is measured in test_bridge_process."""
    robot.sense()
    with closing(Watcher(robot.robot)) as driver:
        driver.ready()
        driver.start(v=0.1).drive(0.5, v=0.1)

        def send_until(condition):
            def sent():
                driver.send(0.1, age_s=1.0)
                return condition()

            wait_for(sent, 5.0)

        send_until(lambda: driver.gate.held or driver.gate.ended)
        # A second later the lease ends, too.
        assert gate_words(driver.statuses) == cell["gate"]
        send_until(lambda: driver.odom.velocity.v == 0.0)


@pytest.mark.parametrize("cell", [FORGED])
def test_forged_commands_change_nothing(robot, cell):
    robot.sense()
    with closing(Watcher(robot.robot)) as driver:
        driver.ready()
        driver.start(v=0.1).drive(0.5, v=0.1)
        for _ in range(15):
            driver.send(0.1)
            payload = twist_stamped(Velocity(-0.1, 0.5), driver.time_ns())
            tag = CommandTag(driver.lease.number, driver.gate.sequence + 5, driver.now_ns)
            driver.command(payload, tag.pack())
            driver.sleep(PERIOD_S)
        assert gate_words(driver.statuses) == cell["gate"]
        assert driver.odom.velocity == pytest.approx((0.1, 0.0), abs=0.02)
        driver.motors(enable=False)
