"""The hazard table, ``tests/data/hazards.yaml``: each cell on the virtual clock, from the robot to the page.

A drive goes through the real firmware or ROS 2 robot, bridge, gate, driver and recording. An injection
changes what the robot sends, what the driver receives or what it sends: from the start, or from the driver's
sixth command on.
"""

from collections import deque

import numpy as np
import pytest
from kit.described import described
from kit.hazard_injections import INJECTIONS
from kit.hazard_table import COURSE, TABLE, cells, cells_with_processes, gate_words, page_words
from kit.virtual_docking import VirtualDocking, place
from kit.virtual_drive import AHEAD, LONG, ChangedLink, VirtualDrive

from bridge.bases import gate_limits
from bridge.gate.limits import Limits
from deploy.check import Preflight
from deploy.check_inputs import Battery
from deploy.drive.measurements import Measurements
from deploy.drive.safety_monitor import SafetyMonitor
from rover_ncp.circuit.policy_file import load_policy
from rover_ncp.core.clock_offset import NS_PER_S
from rover_ncp.core.errors import NoRobot, RoverNcpError
from rover_ncp.core.geometry import Pose
from rover_ncp.course.course import Obstacle
from rover_ncp.robot.description import load_description
from rover_ncp.wire import messages as ros
from rover_ncp.wire.protocol import GateStatus, parse_json
from sim.base.firmware import Firmware
from sim.base.ros2_robot import Ros2Robot
from sim.stack.lines import WALL_NS
from sim.stack.virtual import VirtualBridge
from sim.world.described import described_rover
from sim.world.pymunk_rover import PymunkRover

CASES = ["never came", "stops later", "stale", "one glitch", "latched"]
CASES += ["contradicts another input", "sent by another peer"]
STOP = {"stop": {"topic": "stop", "periodic_s": 0.2}}
GYRO = {"rate_hz": 25}
"""A quarter of the robot's own rate, because most of a drive's time goes into messages."""
ROBOT = described("turtlebot4", topics=STOP, gyro=GYRO)
WITH_POSE = described("turtlebot4", topics=STOP | {"pose": "amcl_pose"}, gyro=GYRO)
LIMITS = {"sonar_stop_m": 0.3}
BRIEF = {
    "none": COURSE.model_copy(update={"horizon_s": 3.5}),
    "required": COURSE.model_copy(update={"horizon_s": 4.5}),
}
"""By the setting ``pose``: longer than the slowest safety rule takes. That of required poses takes 3 s."""
STOP_S = 0.5
"""Most time from a hazard to the stop command: the first requirement of docs/safety.md."""
COVARIANCE = np.diag(np.square([0.01, 0.01, 0.02]))


class Cell(VirtualDrive):
    """A drive straight ahead with an injection, which acts from the start or from the sixth command on."""

    def __init__(self, cell, **settings):
        self.robot = load_description(cell["robot"]) if "robot" in cell else ROBOT
        self.robot = WITH_POSE if "localiser" in cell else self.robot
        self.times, self.held, self.then, self.localiser = 0, deque(), lambda: None, None
        self.active, self.began_ns, self.moved_ns, self.first_ns = cell.get("from") == "start", 0, 0, 0
        policy, course = (load_policy("course"), LONG) if "turn" in cell else (AHEAD, BRIEF[settings["pose"]])
        described = None if self.robot.arcos else self.robot
        super().__init__(policy, course, described=described, **settings)
        self.link.harm = self._begin
        INJECTIONS[cell["inject"]](self)
        if self.active:
            self._begin()

    def _begin(self):
        self.active, self.began_ns = True, self.bridge.now_ns
        self.then()

    def _place(self, ground, start):
        self.rover = PymunkRover(described_rover(self.robot), ground, start)
        known = gate_limits(None, None if self.robot.arcos else self.robot)
        arcos, robot = self.robot.arcos, (self.robot, self.rover)
        self.base = Firmware(*robot) if arcos else Ros2Robot(*robot, epoch_s=WALL_NS / NS_PER_S)
        self.bridge = VirtualBridge(self.base, Limits(**known.model_dump() | LIMITS))
        self.v_max = self.bridge.connection.limits.v_max
        self.recorded, self.gate = [], []
        self.link = ChangedLink(self.bridge, self.recorded.append)
        self.link.change["rover/gate"] = self._note
        self.interrupted = lambda: False
        if self.robot is WITH_POSE:
            self.link.localise = lambda data, arrival_ns: self.base._emit("amcl_pose", data)
        if self.config.pose != "none":
            self.link._start, self.base.observe, self._pose_s = None, self._localise, 0.0

    def _note(self, data):
        self.gate.append(parse_json(GateStatus, ros.read_text(data)))
        if max(map(abs, self.rover.velocity)) > 1e-3:
            self.moved_ns = self.bridge.now_ns
        return data

    def _localise(self, now):
        if now < self._pose_s:
            return
        self._pose_s = now + 0.125
        pose = Pose(*self.rover.pose)
        seen = self.localiser(self, pose) if self.active and self.localiser else pose
        if seen is not None:
            data = ros.pose_with_covariance(seen, COVARIANCE, self.bridge.time_ns(), "course")
            self.link.localise(data, self.bridge.now_ns)

    @property
    def braking_s(self):
        """Time to standstill from the gate's speed limit, with the base's delay and a report."""
        robot = self.robot
        return robot.delays.v_s + self.v_max / robot.motion.decel + 1.0 / min(robot.odometry.rate_hz, 20.0)

    @property
    def moved_s(self):
        """How long the rover moved after the injection began."""
        return max(self.moved_ns - self.began_ns, 0) / NS_PER_S


def drive(cell):
    """Run a cell; return the words of gate and driver, and the drive."""
    pose = "required" if "pose" in cell["inject"] else "none"
    run = Cell(cell, pose=pose, still_s=0.5)
    try:
        result = run.run()
    except NoRobot:
        return "bridge ends", "no drive NoRobot", run
    except RoverNcpError as error:
        return gate_words(run.gate), f"no drive {type(error).__name__}", run
    if result.exit_code != 4:
        return gate_words(run.gate), "drives", run
    rule = result.stopped_by
    return gate_words(run.gate) if run.link.sent else f"refuses {rule}", f"stops {rule}", run


@pytest.mark.parametrize("cell", cells("gate", without="dock"))
def test_gate_driver_and_page_do_as_the_table_says(cell):
    gate, driver, run = drive(cell)
    assert (gate, driver, page_words(run.recording)) == (cell["gate"], cell["driver"], cell["page"])
    if gate == "bridge ends":
        return
    assert run.stands()
    if driver.startswith("stops") and cell.get("from") != "start":
        assert run.moved_s <= cell.get("within", STOP_S) + run.braking_s


@pytest.mark.parametrize("cell", cells("dock"))
def test_docking_is_proven_only_as_the_table_says(cell, monkeypatch):
    for wait in ("REPORT_S", "LATE_S"):  # tests/unit/place/test_judge.py has the real ones
        monkeypatch.setattr(f"deploy.place.judge.{wait}", 3.0)
    wall = [Obstacle(x=2.15, y=1.0, length=0.1, width=0.6)] if "wall" in cell["inject"] else []
    where = place(proof=cell["dock"], retries=0, staging_m=0.3)
    run = VirtualDocking(where, where.staging, obstacles=wall)
    run.active, run.times = True, 0
    INJECTIONS[cell["inject"]](run)
    result = run.run()
    gate = gate_words([parse_json(GateStatus, ros.read_text(data)) for data in run.messages("rover/gate")])
    driver = "docked" if result.dock.success else "not docked"
    assert (gate, driver, page_words(run.recording)) == (cell["gate"], cell["driver"], cell["page"])
    assert run.stands()


CHECKED = [
    each
    for each in cells("check", without="dock")
    if "another peer" not in each.id or each.values[0]["check"] != "passes"
]
"""Without peers that change nothing: a check has a drive's filter, and drives have these cells."""


@pytest.mark.parametrize("cell", CHECKED)
def test_check_finds_what_the_table_says(cell):
    pose = "required" if "pose" in cell["inject"] else "none"
    run, battery = Cell(cell | {"from": "start"}, pose=pose), Battery()
    link = run.link
    link._record = battery.record
    measurements = Measurements(link, pose_frame=None)
    monitor = SafetyMonitor(link, measurements, lambda: False, clock=run.bridge)
    try:
        run.bridge.sleep(1.0)
        monitor.wait()
        described = load_description("p3at-sh") if run.robot.arcos else run.robot
        steps = Preflight(
            link, measurements, monitor, battery, robot=described, on_floor=True, clock=run.bridge
        )
        last = steps.run()[-1]
    except NoRobot:
        assert cell["check"] == "no drive NoRobot"
        return
    assert ("passes" if last.ok else f"no {last.name}") == cell["check"], last.detail
    assert run.stands()


def test_each_cell_of_the_table_says_what_all_must_do_and_many_have_real_processes():
    assert {name: list(cases) for name, cases in TABLE.items()} == dict.fromkeys(TABLE, CASES)
    found = [cell for cases in TABLE.values() for cell in cases.values()]
    assert all({"gate", "driver", "check", "page", "inject"} <= set(cell) for cell in found)
    assert len(cells_with_processes()) >= 12
