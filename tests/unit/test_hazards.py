"""The hazard table, ``tests/data/hazards.yaml``: each cell on the virtual clock, from the robot to the page.

A drive goes through the real firmware or ROS 2 robot, bridge, gate, driver and recording. An injection
changes what the robot sends, what the driver receives or what it sends: from the start, or from the driver's
sixth command on.
"""

import math
from collections import deque
from dataclasses import replace

import numpy as np
import pytest
import yaml
from kit.described import described
from kit.paths import DATA, ROOT
from kit.virtual_docking import STAGING, VirtualDocking, place
from kit.virtual_drive import AHEAD, LOST, ChangedLink, VirtualDrive, short_course

from bridge.base import BaseReport
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
from rover_ncp.wire.cdr import decode, encode
from rover_ncp.wire.protocol import CommandTag, GateStatus, Signed, StopRequest, dump_json, parse_json
from sim.base.faults import Fault
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
NS = 10**9
COVARIANCE = np.diag(np.square([0.01, 0.01, 0.02]))


def cells(*with_keys):
    """Return the cells that have these keys, as parameters."""
    found = [cell for cell in CELLS if set(with_keys) <= set(TABLE[cell[0]][cell[1]])]
    return [pytest.param(*cell, id=", ".join(cell)) for cell in found]


# Injections: what can happen to messages of a robot, a Pioneer's reports, commands and poses.


def on_topic(name, change):
    """Change the messages of a topic of the ROS 2 robot: ``change(drive, payload)`` returns what arrives."""

    def inject(drive):
        robot, sent = drive.base, drive.base.messages

        def messages():
            for topic, payload in sent():
                if topic == name and drive.active:
                    yield from ((name, data) for data in change(drive, payload))
                else:
                    yield topic, payload

        robot.messages = messages

    return inject


def silence(drive, payload):
    return []


def once(change):
    """Apply a change to the first message alone."""

    def changed(drive, payload):
        drive.times += 1
        return change(drive, payload) if drive.times == 1 else [payload]

    return changed


def delay(seconds):
    """Let each message arrive so much later."""

    def delayed(drive, payload):
        drive.held.append((drive.bridge.now_ns, payload))
        due_ns = drive.bridge.now_ns - seconds * NS
        return [drive.held.popleft()[1] for _ in list(drive.held) if drive.held[0][0] <= due_ns]

    return delayed


def repeat(drive, payload):
    """Send the first message again and again."""
    drive.held = drive.held or deque([payload])
    return [drive.held[0]]


def as_stamped(stamp_ns):
    """Give odometry another stamp: ``stamp_ns(drive, its own)``."""

    def changed(drive, payload):
        sample = ros.read_odometry(payload)
        frames = drive.robot.topics.odom_frame, drive.robot.topics.base_frame
        return [ros.odometry(sample.pose, sample.velocity, stamp_ns(drive, sample.stamp_ns), frames=frames)]

    return changed


def turned(drive, payload):
    message = decode(ros.IMU, payload)
    stamp = message.header.stamp
    return [ros.imu(1.0, 1e-6, stamp.sec * NS + stamp.nanosec)]


def wall(drive, payload):
    message = decode(ros.LASER_SCAN, payload)
    stamp = message.header.stamp
    ranges = [0.25] * len(message.ranges)
    return [ros.laser_scan(ranges, (0.15, 12.0), stamp.sec * NS + stamp.nanosec)]


def pressed(value):
    return lambda drive, payload: [encode(ros.BOOL, data=value)]


def press_and_release(drive, payload):
    return [encode(ros.BOOL, data=value) for value in (True, False)]


def contacts(*kinds):
    return lambda drive, payload: [ros.hazards(kinds, drive.bridge.time_ns())]


def on_report(**fields):
    """Change fields of the Pioneer's reports; ``once`` is how many."""
    count = fields.pop("once", math.inf)

    def inject(drive):
        base, receive = drive.bridge.connection.base, drive.bridge.connection.base.receive

        def received(arrival, now):
            return [changed(event) for event in receive(arrival, now)]

        def changed(event):
            if not (isinstance(event, BaseReport) and drive.active and drive.times < count):
                return event
            drive.times += 1
            return replace(event, **fields)

        base.receive = received

    return inject


def frozen(drive):
    """Freeze the pose of odometry while its speeds go on."""
    drive.then = lambda: drive.base.inject(Fault("freeze-odometry"))


def on_command(tag):
    """Change the tags of the driver's commands: ``tag(drive, payload, sequence)``."""

    def inject(drive):
        drive.link.tag = lambda data, sequence: tag(drive, data, sequence) if drive.active else None

    return inject


def resigned(lease=0, age_s=0):
    def tag(drive, data, sequence):
        link = drive.link
        found = CommandTag(link.lease.number + lease, sequence, link.bridge.now_ns - age_s * NS)
        return found.sign(link.lease._secret, Signed.COMMAND, "cmd_vel", data)

    return tag


def lost_once(drive, data, sequence):
    drive.times += 1
    return LOST if drive.times == 1 else None


def forged(drive, data, sequence):
    drive.bridge.command(data, CommandTag(drive.link.lease.number, sequence + 5, drive.bridge.now_ns).pack())


def taken(drive):
    """Let another driver hold the lease."""
    request = b'{"version": 2, "enable": true, "name": "other"}'
    drive.link.request_motors = lambda name, ask=drive.link.request_motors: (
        drive.bridge.query("rover/motors", request),
        ask(name),
    )[1]


def stop_and_release(drive):
    def both():
        for request in (StopRequest(reason="x"), StopRequest(release=True)):
            drive.bridge.query("rover/stop", dump_json(request))

    drive.then = both


def poses(see):
    """Let a localiser send ``see(drive, true pose)``, None for nothing, eight times a second."""

    def inject(drive):
        drive.localiser = see

    return inject


def far(drive, pose):
    return pose._replace(y=pose.y + 1.0)


def far_once(drive, pose):
    drive.times += 1
    return far(drive, pose) if drive.times == 1 else pose


def same(drive, pose):
    drive.held = drive.held or deque([pose])
    return drive.held[0]


TOPICS = ("odom", "imu", "stop", "hazard_detection", "scan", "battery_state")
INJECTIONS = {
    **{f"silence {topic}": on_topic(topic, silence) for topic in TOPICS},
    **{f"truncate {topic} once": on_topic(topic, once(lambda _, data: [data[:-9]])) for topic in TOPICS},
    **{f"repeat {topic}": on_topic(topic, repeat) for topic in TOPICS},
    "delay odom 0.6": on_topic("odom", delay(0.6)),
    "delay imu 1.0": on_topic("imu", delay(1.0)),
    "delay stop 1.0": on_topic("stop", delay(1.0)),
    "delay hazard_detection 1.0": on_topic("hazard_detection", delay(1.0)),
    "delay scan 2.0": on_topic("scan", delay(2.0)),
    "freeze pose": frozen,
    "turn rate of the gyro": on_topic("imu", turned),
    "press stop": on_topic("stop", pressed(True)),
    "press stop every second time": on_topic(
        "stop", lambda d, p: [pressed(v)(d, p)[0] for v in (True, False)]
    ),
    "press stop once more": on_topic("stop", once(lambda d, p: [*pressed(True)(d, p), p])),
    "contact": on_topic("hazard_detection", contacts(ros.BUMP)),
    "contact once": on_topic("hazard_detection", once(contacts(ros.BUMP))),
    "wheels dropped": on_topic("hazard_detection", contacts(ros.WHEEL_DROP)),
    "wall by the scan alone": on_topic("scan", wall),
    "stamps 0": on_topic("odom", as_stamped(lambda drive, own_ns: 0)),
    "stamps stand still": on_topic("odom", as_stamped(lambda drive, own_ns: drive.began_ns)),
    "slow clock": on_topic(
        "odom", as_stamped(lambda drive, own: drive.began_ns + (own - drive.began_ns) // 2)
    ),
    "stamp of tomorrow once": on_topic("odom", once(as_stamped(lambda drive, own_ns: own_ns + 86_400 * NS))),
    "clock of an hour ago": on_topic("odom", as_stamped(lambda drive, own_ns: own_ns - 3600 * NS)),
    "no echoes": on_report(clear_ahead_m=math.nan, clear_behind_m=math.nan),
    "near echo": on_report(clear_ahead_m=0.1),
    "near echo once": on_report(clear_ahead_m=0.1, once=1),
    "near echo behind": on_report(clear_behind_m=0.1),
    "no voltage": on_report(battery_v=0.0),
    "low voltage": on_report(battery_v=10.0),
    "low voltage once": on_report(battery_v=10.0, once=1),
    "voltage NaN": on_report(battery_v=math.nan),
    "no poses": poses(lambda drive, pose: None),
    "late poses": poses(lambda drive, pose: pose),
    "far pose once": poses(far_once),
    "far poses": poses(far),
    "same pose": poses(same),
    "another driver": taken,
    "no commands arrive": on_command(lambda *_: LOST),
    "commands of 1 s ago": on_command(resigned(age_s=1)),
    "commands of another lease": on_command(resigned(lease=1)),
    "one command is lost": on_command(lost_once),
    "forged commands": on_command(forged),
    "stop and release": stop_and_release,
}
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
    assert ("yes" if last.ok else f"no {last.name}") == cell["check"], last.detail
    assert run.stands()


def test_the_table_has_each_cell_with_a_run_or_a_reason():
    assert {name: list(cases) for name, cases in TABLE.items()} == dict.fromkeys(TABLE, CASES)
    for name, case in CELLS:
        assert {"inject", "why"} & set(TABLE[name][case]), (name, case)


@pytest.mark.parametrize(("name", "case"), cells("process"))
def test_a_cell_with_real_processes_names_a_test_that_exists(name, case):
    path, _, test = TABLE[name][case]["process"].partition("::")
    assert f"\ndef {test}(" in (ROOT / path).read_text()
