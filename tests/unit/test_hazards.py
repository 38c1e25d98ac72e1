"""The hazard table, ``tests/data/hazards.yaml``: each cell on the virtual clock, from the robot to the page.

A drive goes through the real firmware or ROS 2 robot, bridge, gate, driver and recording. An injection
changes what the robot sends, what the driver receives or what it sends: from the start, or from the driver's
sixth command on.
"""

from collections import deque

import numpy as np
import pytest
import yaml
from kit.described import described
from kit.hazard_injections import INJECTIONS
from kit.paths import DATA, ROOT
from kit.virtual_docking import STAGING, VirtualDocking, place
from kit.virtual_drive import AHEAD, ChangedLink, VirtualDrive, short_course

from bridge.bases import gate_limits
from bridge.gate.limits import Limits
from deploy.check import Preflight
from deploy.check_inputs import Battery
from deploy.drive.measurements import Measurements
from deploy.drive.safety_monitor import SafetyMonitor
from deploy.place.outcome import Stage
from deploy.view.recorded_drive import read_drive, summarise
from rover_ncp.core.errors import NoRobot, RoverNcpError
from rover_ncp.core.geometry import Pose
from rover_ncp.course.course import Obstacle
from rover_ncp.robot.description import load_description
from rover_ncp.wire import messages as ros
from rover_ncp.wire.protocol import GateStatus, parse_json
from sim.base.firmware import Firmware
from sim.base.ros2_robot import Ros2Robot
from sim.stack.virtual import VirtualBridge
from sim.world.described import described_rover
from sim.world.pymunk_rover import PymunkRover

TABLE = yaml.safe_load((DATA / "hazards.yaml").read_text())
CELLS = [(name, case) for name, cases in TABLE.items() for case in cases]
CASES = ["never came", "stops later", "stale", "one glitch", "latched"]
CASES += ["contradicts another input", "sent by another peer"]
ROBOT = described("turtlebot4", topics={"stop": {"topic": "stop", "periodic_s": 0.2}})
LIMITS = {"sonar_stop_m": 0.3}
COURSE = short_course(2.0, 0.0).model_copy(update={"horizon_s": 6.0})
COVARIANCE = np.diag(np.square([0.01, 0.01, 0.02]))


def cells(*with_keys):
    """Return the cells that have these keys, as parameters."""
    found = [cell for cell in CELLS if set(with_keys) <= set(TABLE[cell[0]][cell[1]])]
    return [pytest.param(*cell, id=", ".join(cell)) for cell in found]


CHARGES = {
    "unknown": lambda at_s: None,
    "only before the approach ends": lambda at_s: at_s is None,
    "always": lambda at_s: True,
    "always before a wall": lambda at_s: True,
    "one report": lambda at_s: at_s is not None and at_s < 1.5,
    "an old report again and again": lambda at_s: True,
}


class Cell(VirtualDrive):
    """A drive straight ahead with an injection, which acts from the start or from the sixth command on."""

    def __init__(self, cell, path=None, **settings):
        self.robot = load_description(cell["robot"]) if "robot" in cell else ROBOT
        self.times, self.held, self.then, self.localiser = 0, deque(), lambda: None, None
        self.active, self.began_ns = cell.get("from") == "start", 0
        super().__init__(AHEAD, COURSE, path, described=None if self.robot.arcos else self.robot, **settings)
        self.link.harm = self._begin
        INJECTIONS[cell["inject"]](self)
        if self.active:
            self._begin()

    def _begin(self):
        self.active, self.began_ns = True, self.bridge.time_ns()
        self.then()

    def _place(self, ground, start):
        self.rover = PymunkRover(described_rover(self.robot), ground, start)
        known = gate_limits(None, None if self.robot.arcos else self.robot)
        self.base = (Firmware if self.robot.arcos else Ros2Robot)(self.robot, self.rover)
        self.bridge = VirtualBridge(self.base, Limits(**known.model_dump() | LIMITS))
        self.recorded, self.gate = [], []
        self.link = ChangedLink(self.bridge, self.recorded.append)
        self.link.change["rover/gate"] = self._note
        self.interrupted = lambda: False
        if self.config.pose != "none":
            self.link._start, self.base.observe, self._pose_s = None, self._localise, 0.0

    def _note(self, data):
        self.gate.append(parse_json(GateStatus, ros.read_text(data)))
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
    def gate_words(self):
        """What the gate did, in the table's words."""
        driven = [status for status in self.gate if status.lease or status.ended]
        if ended := next((status.ended for status in driven if status.ended), ""):
            return f"ends {ended}"
        held = [status.held for status in driven if status.held and status.sequence >= 5]
        return f"holds {held[0]}" if held else "drives"


def drive(cell, path=None):
    """Run a cell; return the words of gate and driver, and the drive."""
    pose = "required" if "pose" in cell["inject"] else "none"
    run = Cell(cell, path, pose=pose)
    try:
        result = run.run()
    except NoRobot:
        return "bridge ends", "no drive NoRobot", run
    except RoverNcpError as error:
        return run.gate_words, f"no drive {type(error).__name__}", run
    if result.exit_code != 4:
        return run.gate_words, "drives", run
    rule = result.stopped_by
    return run.gate_words if run.link.sent else f"refuses {rule}", f"stops {rule}", run


@pytest.mark.parametrize(("name", "case"), cells("inject", "gate"))
def test_gate_and_driver_do_as_the_table_says_and_the_page_says_no_more(name, case, tmp_path):
    cell = TABLE[name][case]
    gate, driver, run = drive(cell, tmp_path / "run.mcap")
    assert (gate, driver) == (cell["gate"], cell["driver"])
    assert gate == "bridge ends" or run.stands()
    result = getattr(run, "result", None)
    if result is not None and result.ticks:
        assert (summarise(read_drive(run.path)).parked == "parked") is (result.state == "parked")


@pytest.mark.parametrize(("name", "case"), cells("dock"))
def test_docking_is_proven_only_as_the_table_says(name, case, tmp_path):
    cell = TABLE[name][case]
    wall = [Obstacle(x=2.15, y=1.0, length=0.1, width=0.6)] if "wall" in cell["inject"] else []
    where, path = place(proof="charging", retries=0), tmp_path / "dock.mcap"
    run = VirtualDocking(where, STAGING, path=path, obstacles=wall)
    charges, waits, stamps = CHARGES[cell["inject"]], [], []

    def battery(data):
        now_s, state = run.bridge.monotonic(), run.link.statuses[-1].state if run.link.statuses else ""
        waits.extend([now_s] if state.startswith(Stage.WAIT_FOR_CHARGE) and not waits else [])
        stamps.append(ros.read_battery(data).stamp_ns)
        charging = charges(now_s - waits[0] if waits else None)
        stamp_ns = stamps[0] if "old report" in cell["inject"] else stamps[-1]
        return ros.battery_state(12.5, stamp_ns, charging=charging)

    run.link.change["battery_state"] = battery
    result = run.run()
    assert ("docked" if result.dock.success else "not docked") == cell["driver"]
    assert run.stands()
    assert (summarise(read_drive(path)).parked == "parked") is result.dock.success


@pytest.mark.parametrize(("name", "case"), cells("check"))
def test_check_finds_what_the_table_says(name, case):
    cell = TABLE[name][case]
    run, battery = Cell(cell | {"from": "start"}), Battery()
    link = run.link
    link._record = battery.record
    measurements = Measurements(link, pose_frame=None)
    monitor = SafetyMonitor(link, measurements, lambda: False, clock=run.bridge)
    try:
        run.bridge.sleep(3.0)
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


def test_the_table_has_each_cell_with_a_run_or_a_reason():
    assert {name: list(cases) for name, cases in TABLE.items()} == dict.fromkeys(TABLE, CASES)
    for name, case in CELLS:
        assert {"inject", "why"} & set(TABLE[name][case]), (name, case)


@pytest.mark.parametrize(("name", "case"), cells("process"))
def test_a_cell_with_real_processes_names_a_test_that_exists(name, case):
    path, _, test = TABLE[name][case]["process"].partition("::")
    assert f"\ndef {test}(" in (ROOT / path).read_text()
