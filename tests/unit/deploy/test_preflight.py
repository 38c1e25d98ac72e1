"""The check of robots that are well and of others, on the virtual clock."""

from dataclasses import replace

import pytest
from kit.described import described
from kit.virtual_drive import ChangedLink

from bridge.gate.limits import Limits
from bridge.pioneer.connection import Received
from bridge.pioneer.framing import encode_frame
from bridge.pioneer.packets import Kind
from deploy.check import Preflight
from deploy.check_inputs import Battery
from deploy.check_moves import PERIOD_S
from deploy.drive.measurements import Measurements
from deploy.drive.safety_monitor import SafetyMonitor
from rover_ncp.core.clock_offset import NS_PER_S
from rover_ncp.core.errors import SafetyStop
from rover_ncp.core.geometry import ORIGIN, Velocity
from rover_ncp.robot.description import DeadBand, load_description
from rover_ncp.wire.messages import odometry, read_odometry
from rover_ncp.wire.protocol import Fence
from sim.base.faults import Faults, parse_fault
from sim.base.firmware import Firmware
from sim.base.models import config_of
from sim.base.ros2_robot import Ros2Robot
from sim.stack.virtual import VirtualBridge
from sim.world.described import described_rover
from sim.world.pymunk_rover import Ground, PymunkRover


def check(model=None, robot="p3at-sh", limits=None, config=None, clock_rate=1.0, odometry=None, faults=()):
    """Check a robot on the virtual clock; return the findings, the link and the rover."""
    robot = load_description(robot) if isinstance(robot, str) else robot
    rover = PymunkRover(described_rover(robot, motors=True), Ground(()))
    faults = Faults([parse_fault(fault) for fault in faults])
    base = Firmware(robot, rover, faults, config=config) if robot.arcos else Ros2Robot(robot, rover)
    if not robot.arcos:
        base._stamp_ns = lambda: round(clock_rate * base.now * NS_PER_S)
    bridge, battery = VirtualBridge(base, limits), Battery()
    bridge.sleep(3.0)
    link = ChangedLink(bridge, battery.record)
    link._start = None  # no poses
    if odometry:
        link.change["odom"] = odometry
    measurements = Measurements(link, pose_frame=None)
    monitor = SafetyMonitor(link, measurements, lambda: False, clock=bridge)
    monitor.wait()
    expected = load_description(model) if isinstance(model, str) else model
    preflight = Preflight(link, measurements, monitor, battery, robot=expected, clock=bridge)
    return preflight.run(), link, rover


def assert_stopped(link, rover):
    link.bridge.sleep(0.5)
    assert max(map(abs, rover.velocity)) < 1e-3
    assert link.gate.lease == 0


def with_watchdog(ms):
    return replace(config_of(load_description("p3at-sh")), watchdog=ms)


def doubled(data):
    """Return odometry of a way that is twice as long."""
    sample = read_odometry(data)
    pose = sample.pose._replace(x=2.0 * sample.pose.x)
    return odometry(pose, sample.velocity, sample.stamp_ns)


NAMES = ["link", "odometry", "battery", "stop", "watchdog", "motors", "forward"]
NAMES += ["slow", "left", "silence"]


@pytest.mark.parametrize("robot", ["p3at-sh", "husky-a200"])
def test_robot_that_is_well_passes_all_checks_and_stands(robot):
    findings, link, rover = check(robot=robot, model=robot)
    assert [finding for finding in findings if not finding.ok] == []
    names = [finding.name for finding in findings]
    assert [name for name in names if name in NAMES] == NAMES
    assert {"gyro", "gyro-turn"} & set(names) == (set() if robot == "p3at-sh" else {"gyro", "gyro-turn"})
    if robot == "p3at-sh":
        assert findings[-3].detail == "follows commands from 0.005 m/s and 0.02 rad/s on"
    assert_stopped(link, rover)
    assert {"silence"} <= link.gate.stops.keys() <= {"silence", "odometry"}


@pytest.mark.parametrize(
    ("options", "name", "words"),
    [
        ({"model": "turtlebot4"}, "model", "the bridge drives p3at-sh, expected turtlebot4"),
        ({"robot": "husky-a200", "odometry": doubled}, "forward", "has odometry another unit or scale?"),
        ({"limits": Limits(v_max=0.03)}, "forward", "the gate limited commands: speed"),
        ({"config": with_watchdog(5000)}, "motors", "the base's watchdog is 5 s; set WatchDog in its FLASH"),
    ],
)
def test_robot_that_is_not_well_fails_the_check_that_finds_it(options, name, words):
    findings, link, rover = check(**options)
    assert (findings[-1].name, findings[-1].ok) == (name, False)
    assert all(finding.ok for finding in findings[:-1])
    assert words in findings[-1].detail
    assert_stopped(link, rover)


@pytest.mark.parametrize(
    ("fault", "reason"),
    [
        *((f"{hazard}@0.5-0.8", hazard) for hazard in ("stop-button", "bumper", "stall")),
        ("reset@0.5", "no-base"),
        ("mute@0.4-1.1", "no-base"),
    ],
)
def test_a_check_that_a_hazard_stopped_does_not_drive_again_when_the_hazard_ends(fault, reason):
    findings, link, rover = check(faults=[fault])
    assert (findings[-1].name, findings[-1].ok) == ("forward", False)
    assert f"the gate stopped the robot: {reason}" in findings[-1].detail
    assert rover.pose.x < 0.1  # a whole motion is 0.15 m
    assert_stopped(link, rover)


@pytest.mark.parametrize("seconds", [0.45, 1.2])
@pytest.mark.parametrize("begin_s", [0.4, 1.2, 1.45, 4.0])
def test_a_check_goes_on_after_a_stall_of_this_computer(begin_s, seconds, monkeypatch):
    """After more than a second the gate has ended the lease; before, the rover stood for a moment."""
    stalled, command = [], ChangedLink.command

    def stall(link, velocity):
        if link.gate.lease and not stalled and len(link.sent) >= begin_s / PERIOD_S:
            stalled.append(link.gate.lease)
            link.bridge.sleep(seconds)
        return command(link, velocity)

    monkeypatch.setattr(ChangedLink, "command", stall)
    findings, link, rover = check()
    assert stalled
    assert [finding for finding in findings if not finding.ok] == []
    assert_stopped(link, rover)


def test_the_stop_without_commands_is_not_proven_by_a_rover_that_the_fence_holds():
    findings, link, rover = check(limits=Limits(fence=Fence(x_min=-1.0, x_max=0.27, y_min=-1.0, y_max=1.0)))
    assert (findings[-1].name, findings[-1].ok) == ("silence", False)
    assert "geofence" in findings[-1].detail
    assert_stopped(link, rover)


def test_a_robot_whose_clock_runs_faster_is_found_before_it_moves():
    findings, _, rover = check(robot="turtlebot4", model="turtlebot4", clock_rate=1.03)
    assert (findings[-1].name, findings[-1].ok) == ("clock", False)
    assert "its stamps advance by 1.03 s in a second of this computer" in findings[-1].detail
    assert rover.pose == ORIGIN


def with_band(v, omega):
    return described("p3at-sh", motion={"dead_band": DeadBand(v=v, omega=omega)})


@pytest.mark.parametrize(
    ("band", "known", "ok", "words"),
    [
        ((0.05, 0.14), (0.05, 0.14), True, "from 0.05 m/s and 0.16 rad/s on"),
        ((0.05, 0.14), None, False, "for the robot's description: motion.dead_band: {v: 0.05, omega: 0.16}"),
        ((0.08, 0.1), (0.08, 0.1), False, "expected from 0.05 m/s and 0.26 rad/s on at most"),
    ],
)
def test_dead_band_is_measured_and_a_driver_must_know_it(band, known, ok, words):
    findings, _, _ = check(robot=with_band(*band), model=known and with_band(*known))
    (found,) = [finding for finding in findings if finding.name == "slow"]
    assert found.ok is ok
    assert all(finding.ok for finding in findings) is ok  # it is turned faster than its dead band
    assert words in found.detail


@pytest.mark.parametrize(("watchdog_ms", "refused"), [(200, False), (2000, False), (2500, True), (0, True)])
def test_a_pioneer_that_would_drive_on_for_longer_than_two_seconds_is_not_driven(watchdog_ms, refused):
    robot = load_description("p3at-sh")
    base = Firmware(robot, PymunkRover(described_rover(robot), Ground(())), config=with_watchdog(watchdog_ms))
    bridge = VirtualBridge(base)
    bridge.sleep(3.0)
    link = ChangedLink(bridge, lambda *_: None)
    if refused:
        with pytest.raises(SafetyStop, match="set WatchDog in its FLASH"):
            link.request_motors("driver")
    else:
        link.request_motors("driver")
    assert (link.gate.lease == 0) is refused


def test_a_pioneer_that_reports_no_watchdog_is_driven_and_nobody_says_that_it_does(monkeypatch):
    def emit(self, packet):
        if packet.kind is not Kind.CONFIG:
            emit_any(self, packet)

    emit_any, robot = Firmware._emit, load_description("p3at-sh")
    monkeypatch.setattr(Firmware, "_emit", emit)
    bridge = VirtualBridge(Firmware(robot, PymunkRover(described_rover(robot), Ground(()))))
    bridge.sleep(5.0)
    link = ChangedLink(bridge, lambda *_: None)
    base = link.about_base()
    assert (base.state, base.timeout_s) == ("unknown", 2.0)
    link.request_motors("driver")
    assert link.gate.lease == 1


def test_a_configuration_that_arrives_late_ends_the_lease_of_a_pioneer_that_must_not_be_driven():
    robot = load_description("p3at-sh")
    base = Firmware(robot, PymunkRover(described_rover(robot), Ground(())))
    bridge = VirtualBridge(base)
    bridge.sleep(3.0)
    link = ChangedLink(bridge, lambda *_: None)
    link.request_motors("driver")
    late = with_watchdog(5000).encode()
    bridge.connection.arrivals.append(Received(encode_frame(late.kind, late.payload)))
    link.command(Velocity(0.1, 0.0))
    bridge.sleep(0.3)
    assert link.gate.lease == 0
    with pytest.raises(SafetyStop, match="set WatchDog in its FLASH"):
        link.request_motors("driver")
