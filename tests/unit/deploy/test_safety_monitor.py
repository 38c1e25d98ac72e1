"""The checks of a driver on virtual time: age of odometry, response to commands, words of a stop."""

from types import SimpleNamespace

import pytest

from bridge.base import Lost
from deploy.drive.controller import Controller
from deploy.drive.measurements import NS, Measurements
from deploy.drive.safety_monitor import ResponseCheck, SafetyMonitor
from deploy.estimator.settings import EstimatorSettings
from rover_ncp.circuit.policy_file import load_policy
from rover_ncp.core.errors import SafetyStop
from rover_ncp.core.geometry import STANDSTILL, Pose, Velocity
from rover_ncp.course.course import load_course
from rover_ncp.wire.protocol import StopRequest, dump_json
from sim.pioneer.firmware import Firmware
from sim.stack.virtual import VirtualBridge, VirtualLink
from sim.world.described import default_rover
from sim.world.pymunk_rover import Ground, PymunkRover


def stop_after(pauses_s, fresh=False):
    """Check after each pause, with odometry of time 0 or ``fresh`` one; return the words of the stop."""
    now_ns = [0]
    clock = SimpleNamespace(monotonic_ns=lambda: now_ns[0])
    link = SimpleNamespace(bridge_alive=True)
    measurements = SimpleNamespace(newest=SimpleNamespace(ref=SimpleNamespace(measured_ns=0)))
    monitor = SafetyMonitor(link, measurements, lambda: False, clock=clock)
    monitor.check()
    with pytest.raises(SafetyStop, match="odometry-age") as stop:
        for pause_s in pauses_s:
            now_ns[0] += round(pause_s * NS)
            if fresh:
                measurements.newest = SimpleNamespace(ref=SimpleNamespace(measured_ns=now_ns[0]))
            monitor.check()
    return str(stop.value)


def test_old_odometry_is_not_blamed_on_the_robot_while_the_driver_did_not_run():
    assert "; the driver process was stalled for 0.31 s" in stop_after([0.02, 0.31, 0.1])
    assert "stalled" not in stop_after([0.02] * 30)


def test_a_driver_that_did_not_run_stops_also_when_it_finds_fresh_odometry():
    """After a pause it is a race which thread runs first, the one that receives or the one that checks."""
    words = stop_after([0.3, 0.35, 0.41], fresh=True)
    assert words.endswith("(limit 0.4 s); the driver process was stalled for 0.41 s")


class Driven:
    """A driver that holds the lease of a bridge, and drives."""

    def __init__(self):
        self.bridge = VirtualBridge(Firmware("p3at-sh", PymunkRover(default_rover(), Ground(()))))
        self.bridge.sleep(3.0)
        self.link = VirtualLink(self.bridge, Pose(0.0, 0.0, 0.0))
        self.bridge.sleep(0.2)
        self.measurements = Measurements(self.link)
        self.monitor = SafetyMonitor(self.link, self.measurements, lambda: False, clock=self.bridge)
        self.monitor.wait()
        self.link.request_motors("test")
        self.monitor.granted()
        self.drive(0.5)

    def drive(self, seconds, commands=True):
        for _ in range(round(seconds / 0.05)):
            if commands:
                self.link.command(Velocity(0.1, 0.0))
            self.bridge.sleep(0.05)
            self.measurements.odometry(0)
            self.monitor.check()

    def request_stop(self, **fields):
        self.bridge.query("rover/stop", dump_json(StopRequest(**fields)))

    def words(self):
        """Drive on; return the words of the stop."""
        with pytest.raises(SafetyStop) as stop:
            self.drive(1.0)
        return str(stop.value)


@pytest.mark.parametrize(
    ("request_", "expected"),
    [
        ({"reason": "the live page's Stop button"}, "stopped by the live page's Stop button"),
        ({"reason": "Anna: smoke"}, "stopped by Anna: smoke"),
        ({}, "stopped by a client that gave no name"),
    ],
)
def test_a_requested_stop_names_who_requested_it(request_, expected):
    driven = Driven()
    driven.request_stop(**request_)
    assert driven.words() == expected


def test_a_stop_that_is_released_at_once_keeps_its_name():
    driven = Driven()
    driven.request_stop(reason="Anna")
    driven.request_stop(release=True)
    assert driven.words() == "stopped by Anna"


@pytest.mark.parametrize("reason", ["/teleop publishes /cmd_vel too", "ü" * 1000])
def test_a_lost_base_is_named_as_the_bridge_knows_it(reason):
    driven = Driven()
    driven.bridge._node._handle([Lost(reason)], driven.bridge.monotonic())
    assert driven.words().startswith(f"stopped by no-base: the base is not connected: {reason}"[:200])
    with pytest.raises(SafetyStop, match=f"the base is not connected: {reason[:30]}"):
        driven.link.request_motors("again")


def test_a_lease_that_lapsed_has_words():
    driven = Driven()
    with pytest.raises(SafetyStop) as stop:
        driven.drive(1.5, commands=False)
    assert str(stop.value) == "stopped by lease-lapsed: no command arrived for longer than a lease lasts"


def first_complaint(asked, driven, ticks=100):
    """The tick of the first complaint, None if there is none; both are functions of the tick."""
    watch = ResponseCheck()
    return next((k for k in range(ticks) if watch.tick(asked(k), driven(k))), None)


@pytest.mark.parametrize(
    "asked", [Velocity(0.06, 0), Velocity(-0.16, 0), Velocity(0, 0.12), Velocity(0, -0.18)]
)
def test_commands_that_the_rover_does_not_follow_are_noticed_within_two_seconds(asked):
    assert first_complaint(lambda k: asked, lambda k: STANDSTILL) == 17
    # Frozen in the middle of a drive.
    assert 25 <= first_complaint(lambda k: asked, lambda k: asked if k < 20 else STANDSTILL) <= 40


@pytest.mark.parametrize("asked", [Velocity(0.04, 0), Velocity(0, 0.09), STANDSTILL])
def test_commands_below_the_resolution_are_not_judged(asked):
    assert first_complaint(lambda k: asked, lambda k: STANDSTILL) is None


@pytest.mark.parametrize("seconds", [1, 3])
def test_a_turn_to_and_fro_that_cancels_out_is_not_judged(seconds):
    def asked(k):
        return Velocity(0.0, 0.18 if (k // (10 * seconds)) % 2 else -0.18)

    assert first_complaint(asked, lambda k: asked(k - 5) if k > 5 else STANDSTILL) is None


@pytest.mark.parametrize("lag", [1, 2, 4, 7])
@pytest.mark.parametrize("ticks", [3, 6, 9])
def test_a_burst_of_commands_is_not_judged_when_it_is_long_over(lag, ticks):
    # As a circuit does that turns the last few degrees on the spot and then stands.
    def asked(k):
        return Velocity(0.0, -0.36) if 20 <= k < 20 + ticks else STANDSTILL

    assert first_complaint(asked, lambda k: asked(k - lag)) is None


@pytest.mark.parametrize(
    "model",
    [
        default_rover(),
        default_rover(accel=0.21, delay_v_s=0.3, delay_omega_s=0.3),
    ],
)
def test_a_rover_that_follows_is_never_stopped(model, request):
    """A whole manoeuvre, on the base as it is and on a sluggish one (delays 300 ms, acceleration −30 %)."""
    course, rover = load_course("parking"), PymunkRover(model, Ground())
    for policy in ("parking", str(request.config.rootpath / "tests/data/golden/parking.bnn")):
        controller, watch = Controller(load_policy(policy), course, EstimatorSettings()), ResponseCheck()
        controller.start(Pose(0, 0, 0), -0.1)
        rover.set_pose(Pose(0, 0, 0))
        for index in range(course.ticks):
            controller.estimator.odometry(rover.pose, rover.velocity, 0.1 * index)
            tick = controller.tick(index, 0.1 * index)
            assert watch.tick(tick.command, tick.estimate.velocity) == ""
            rover.command(*tick.command)
            for _ in range(10):
                rover.substep()
