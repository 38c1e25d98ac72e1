"""The gate: what stops the rover, what does not count, and that nothing else ever gets through."""

import math
from dataclasses import replace

import pytest

from bridge.gate import ROS_DRIVER, step
from bridge.gate_state import (
    ZERO,
    BaseLost,
    Command,
    Enable,
    Heard,
    Reason,
    Release,
    State,
    Stop,
    Tick,
    Unlatch,
)
from bridge.limits import Fence, Limits
from rover_ncp.core.geometry import Velocity
from rover_ncp.core.lease import CommandTag

ME, OTHER = b"me".ljust(16), b"other".ljust(16)
SLOW = Velocity(0.1, -0.1)
LIMITS = Limits()


class Gate:
    """A gate with its state. Times are the bridge's; the driver's clock differs by ``ahead_s``."""

    def __init__(self, limits=LIMITS, accept_ros=False, ahead_s=1234.5):
        self.state, self.limits, self.accept_ros, self.ahead_s = State(), limits, accept_ros, ahead_s
        self.sequence = 0

    def at(self, now, event):
        self.state, verdict = step(self.state, event, now, self.limits, self.accept_ros)
        return verdict

    def stamp(self, now):
        return round((now + self.ahead_s) * 1e9)

    def drive(self, now, velocity=SLOW, driver=ME, age=0.0, sequence=None):
        """A command that was sent ``age`` seconds before it arrives at ``now``."""
        if sequence is None:
            self.sequence += 1
            sequence = self.sequence
        return self.at(now, Command(velocity, CommandTag(driver, sequence, self.stamp(now - age))))

    def enable(self, now, driver=ME, age=0.0):
        return self.at(now, Enable(driver, "deploy", self.stamp(now - age)))

    def driving(self, now=0.0):
        """Bring the gate to where a command is in force since ``now``, at full size."""
        self.at(now - 0.3, Heard(motors_on=False))
        assert self.enable(now - 0.3).refusal is None
        self.at(now - 0.2, Heard())
        for k in (2, 1, 0):
            verdict = self.drive(now - 0.05 * k)
        self.at(now, Heard())
        assert verdict.velocity == SLOW
        return self


# What it takes to drive


def test_nothing_moves_before_the_base_was_heard():
    gate = Gate()
    assert gate.at(0.0, Tick()).held is Reason.NO_BASE
    assert gate.enable(0.1).refusal is Reason.NO_BASE
    verdict = gate.drive(0.2)
    assert (verdict.velocity, verdict.motors, verdict.dropped) == (ZERO, False, Reason.NO_BASE)


def test_nothing_moves_before_a_driver_asked():
    gate = Gate()
    gate.at(0.0, Heard(motors_on=True))
    verdict = gate.drive(0.1)
    assert (verdict.velocity, verdict.motors) == (ZERO, False)
    assert (verdict.held, verdict.dropped) == (Reason.NO_LEASE, Reason.NO_LEASE)


def test_nothing_moves_before_the_motors_are_on():
    gate = Gate()
    gate.at(0.0, Heard(motors_on=False))
    assert gate.enable(0.1).motors
    verdict = gate.drive(0.2)
    assert (verdict.velocity, verdict.held) == (ZERO, Reason.MOTORS_OFF)
    gate.at(0.25, Heard())
    assert gate.drive(0.3).velocity.v > 0.0


def test_a_base_not_heard_of_late_is_not_given_to_anybody():
    gate = Gate()
    gate.at(0.0, Heard())
    assert gate.enable(0.5).refusal is Reason.ODOMETRY
    gate.at(0.6, Heard())
    assert gate.enable(0.7).refusal is None


def test_a_command_in_force_stays_and_counts():
    gate = Gate().driving()
    assert gate.at(0.2, Tick()).velocity == SLOW
    assert gate.state.accepted == 3
    assert not gate.state.dropped
    assert not gate.state.stops


# Limits


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize(
    ("asked", "got", "reason"),
    [
        (Velocity(0.3, 0.0), Velocity(0.3, 0.0), None),
        (Velocity(math.nextafter(0.3, 1.0), 0.0), Velocity(0.3, 0.0), Reason.SPEED),
        (Velocity(1e300, 0.0), Velocity(0.3, 0.0), Reason.SPEED),
        (Velocity(0.0, 0.6), Velocity(0.0, 0.6), None),
        (Velocity(0.0, 7.0), Velocity(0.0, 0.6), Reason.TURN),
    ],
)
def test_speeds_are_cut_to_the_limits(sign, asked, got, reason):
    gate = Gate(LIMITS.model_copy(update={"accel": 5.0, "alpha": 20.0})).driving()
    asked, got = (Velocity(sign * item.v, sign * item.omega) for item in (asked, got))
    for k in range(1, 4):
        verdict = gate.drive(0.1 * k, asked)
    assert verdict.velocity == got
    assert gate.state.limited == ({} if reason is None else {reason: 3})


def test_speeds_grow_no_faster_than_allowed_and_brake_at_once():
    gate = Gate().driving()
    verdict = gate.drive(0.04, Velocity(0.3, -0.6))
    assert verdict.velocity == pytest.approx((0.1 + 0.04 * 1.0, -0.1 - 0.04 * 4.0))
    assert gate.at(0.06, Tick()).velocity == pytest.approx((0.16, -0.34))
    assert gate.drive(0.06, Velocity(0.02, 0.0)).velocity == (0.02, 0.0)
    assert gate.drive(0.08, Velocity(-0.3, 0.0)).velocity == pytest.approx((-0.02, 0.0))


def test_a_loop_that_slept_earns_no_acceleration():
    gate = Gate(LIMITS.model_copy(update={"silence_s": 0.4}))
    gate.driving()
    gate.at(0.25, Heard())
    gate.state = replace(gate.state, now=0.0, out=ZERO)
    assert gate.drive(0.3, Velocity(0.3, 0.0)).velocity.v == pytest.approx(0.1)


FENCE = LIMITS.model_copy(update={"fence": Fence(x_min=-1.0, x_max=2.0, y_min=-1.0, y_max=1.0), "brake": 0.5})


@pytest.mark.parametrize(
    ("base", "velocity", "passes"),
    [
        (Heard(x=0.0), Velocity(0.1, 0.0), True),
        # 0.1 m/s reaches 0.03 m while it reacts and 0.01 m while it brakes.
        (Heard(x=1.95), Velocity(0.1, 0.0), True),
        (Heard(x=1.965), Velocity(0.1, 0.0), False),
        (Heard(x=1.965), Velocity(-0.1, 0.0), True),
        (Heard(x=1.965), Velocity(0.0, 0.3), True),
        (Heard(x=1.965, theta=math.pi), Velocity(0.1, 0.0), True),
        (Heard(x=-0.99, theta=math.pi), Velocity(0.1, 0.0), False),
        (Heard(y=0.99, theta=math.pi / 2), Velocity(0.1, 0.0), False),
        (Heard(y=-0.99, theta=math.pi / 2), Velocity(-0.1, 0.0), False),
        (Heard(x=2.5), Velocity(0.1, 0.0), False),
        (Heard(x=2.5), Velocity(-0.1, 0.0), True),
        (Heard(x=2.5, theta=math.pi / 2), Velocity(0.1, 0.0), False),
    ],
)
def test_nobody_drives_out_of_the_fence_but_anybody_back(base, velocity, passes):
    gate = Gate(FENCE).driving()
    gate.at(0.1, base)
    verdict = gate.drive(0.1, velocity)
    assert verdict.held is (None if passes else Reason.GEOFENCE)
    if not passes:
        assert verdict.velocity == ZERO
        assert gate.state.stops == {Reason.GEOFENCE: 1}
        assert gate.drive(0.15, ZERO).held is None  # it pauses the drive, it does not end it


# Hazards


HAZARDS = [
    (Heard(stop_pressed=True), Reason.STOP_BUTTON),
    (Heard(bumped=True), Reason.BUMPER),
    (Heard(stalled=True), Reason.STALL),
]


@pytest.mark.parametrize(("event", "reason"), [*HAZARDS, (BaseLost(), Reason.NO_BASE)])
def test_a_hazard_stops_and_ends_the_lease(event, reason):
    gate = Gate().driving()
    verdict = gate.at(0.01, event)
    assert (verdict.velocity, verdict.held) == (ZERO, reason)
    assert gate.state.lease is None
    assert gate.state.ended is reason
    assert gate.state.stops == {reason: 1}
    assert gate.drive(0.02).dropped is reason
    assert gate.enable(0.03).refusal is reason
    assert gate.at(0.1, Heard()).velocity == ZERO
    assert gate.drive(0.11).dropped is Reason.NO_LEASE
    assert gate.enable(0.12).refusal is None
    assert gate.drive(0.2).velocity != ZERO


@pytest.mark.parametrize(
    ("reason", "emergency"),
    [
        (Reason.STOPPED, True),
        (Reason.STOP_BUTTON, True),
        (Reason.BUMPER, True),
        (Reason.STALL, True),
        (Reason.SILENCE, False),
        (Reason.NO_LEASE, False),
    ],
)
def test_only_what_may_have_hurt_brakes_harder_than_usual(reason, emergency):
    gate = Gate().driving()
    events = {value: event for event, value in HAZARDS} | {Reason.STOPPED: Stop("now")}
    verdict = gate.at(0.35, Heard())
    if reason is Reason.NO_LEASE:
        verdict = gate.at(0.35, Release(ME))
    elif reason in events:
        verdict = gate.at(0.35, events[reason])
    assert verdict.held is reason
    assert verdict.emergency is emergency


def test_a_stop_is_latched_until_released_and_the_driver_asks_again():
    gate = Gate().driving()
    assert gate.at(0.0, Stop("child on the floor")).velocity == ZERO
    assert gate.state.latched == "child on the floor"
    gate.at(0.1, Heard())
    assert gate.drive(0.1).dropped is Reason.STOPPED
    assert gate.enable(0.2).refusal is Reason.STOPPED
    assert gate.at(0.2, Unlatch()).velocity == ZERO
    assert gate.drive(0.2).dropped is Reason.NO_LEASE
    assert gate.enable(0.3).refusal is None


def test_a_low_battery_counts_when_it_lasts():
    gate = Gate().driving()
    low, fine = Heard(battery_v=10.9), Heard(battery_v=11.0)
    for k, report in enumerate([low] * 19 + [fine] + [low] * 20):
        gate.at(0.1 * k, report)
        assert gate.drive(0.1 * k).held is None
    gate.at(4.0, low)
    assert gate.drive(4.0).dropped is Reason.LOW_BATTERY
    assert gate.enable(4.0).refusal is Reason.LOW_BATTERY


def test_a_base_that_reports_no_voltage_is_not_low():
    gate = Gate().driving()
    for k in range(40):
        gate.at(0.1 * k, Heard(battery_v=0.0))
        assert gate.drive(0.1 * k).held is None


def test_motors_that_go_off_by_themselves_end_the_lease():
    gate = Gate().driving()
    for k in range(1, 10):
        gate.at(0.1 * k, Heard())
        gate.drive(0.1 * k)
    verdict = gate.at(1.0, Heard(motors_on=False))
    assert (verdict.velocity, verdict.held, verdict.motors) == (ZERO, Reason.MOTORS_OFF, False)
    assert gate.state.ended is Reason.MOTORS_OFF


def test_motors_that_never_come_on_end_the_lease():
    gate = Gate()
    gate.at(0.0, Heard(motors_on=False))
    gate.enable(0.0)
    for k in range(1, 11):
        gate.at(0.1 * k, Heard(motors_on=False))
        assert gate.drive(0.1 * k).dropped is None
    gate.at(1.05, Heard(motors_on=False))
    assert gate.drive(1.05).dropped is Reason.NO_LEASE
    assert gate.state.ended is Reason.MOTORS_OFF


# Lateness


def test_silence_stops_and_a_later_command_drives_on():
    gate = Gate().driving()
    gate.at(0.25, Heard())
    assert gate.at(0.29, Tick()).velocity == SLOW
    verdict = gate.at(0.31, Tick())
    assert (verdict.velocity, verdict.held) == (ZERO, Reason.SILENCE)
    assert gate.state.stops == {Reason.SILENCE: 1}
    gate.at(0.55, Heard())
    assert gate.drive(0.6).velocity != ZERO


def test_a_command_that_was_under_way_for_long_counts_for_less_long():
    gate = Gate().driving()
    gate.drive(0.2, age=0.15)
    gate.at(0.3, Heard())
    assert gate.at(0.34, Tick()).velocity != ZERO
    assert gate.at(0.36, Tick()).held is Reason.SILENCE


def test_the_lease_lapses_without_commands():
    gate = Gate().driving()
    for k in range(1, 10):
        gate.at(0.1 * k, Heard())
    assert gate.state.lease is not None
    assert gate.at(1.01, Heard()).held is Reason.NO_LEASE
    assert gate.state.ended is Reason.LEASE_LAPSED
    assert gate.enable(1.05, OTHER).refusal is None


def test_odometry_that_stops_stops_the_rover_and_goes_on_when_it_comes_back():
    gate = Gate().driving()
    for k in range(1, 7):
        verdict = gate.drive(0.05 * k)
    assert verdict.velocity == SLOW
    assert gate.drive(0.36).held is Reason.ODOMETRY
    gate.at(0.4, Heard())
    assert gate.drive(0.42).velocity != ZERO


@pytest.mark.parametrize("field", ["x", "y", "theta", "v", "omega"])
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_odometry_in_no_numbers_is_none(field, value):
    gate = Gate().driving()
    verdict = gate.at(0.05, Heard(**{field: value}))
    assert (verdict.velocity, verdict.held) == (ZERO, Reason.ODOMETRY)


def test_a_link_that_stalls_delivers_nothing_but_stale_commands():
    gate = Gate().driving()
    sent = [(0.1 * k, gate.sequence + k) for k in range(1, 50)]
    for moment, sequence in sent:  # all of them arrive at 5 s
        gate.at(5.0, Heard())
        verdict = gate.drive(5.0, age=5.0 - moment, sequence=sequence)
        assert verdict.velocity == ZERO
        assert verdict.dropped in {Reason.NO_LEASE, Reason.STALE}


def test_commands_older_than_the_lease_do_not_count_however_young_they_look():
    gate = Gate()
    gate.at(0.0, Heard())
    gate.enable(0.0)
    stamp = gate.stamp(0.0) - 1
    assert gate.at(0.0, Command(SLOW, CommandTag(ME, 1, stamp))).dropped is Reason.STALE


def test_a_link_that_is_slow_from_the_first_command_on_is_found_out():
    gate = Gate()
    gate.at(9.9, Heard())
    gate.enable(9.9)
    gate.at(10.2, Heard())
    assert gate.drive(10.2, age=0.19).dropped is None
    assert gate.drive(10.25, age=0.21).dropped is Reason.STALE


def test_asking_again_forgets_what_was_known_of_the_clock():
    gate = Gate().driving()
    gate.ahead_s += 3600.0
    assert gate.drive(0.1).dropped is None  # it seems quicker than any before it
    gate.ahead_s -= 3600.0
    assert gate.drive(0.2).dropped is Reason.STALE
    gate.at(0.3, Heard())
    assert gate.enable(0.3).refusal is None
    assert gate.drive(0.4).dropped is None


@pytest.mark.parametrize("drift", [1e-4, -1e-4])
def test_clocks_that_drift_apart_for_three_hours_do_not_matter(drift):
    gate = Gate().driving()
    for k in range(1, 3 * 3600 * 2):
        now = 0.5 * k
        gate.ahead_s = 1234.5 + drift * now
        gate.at(now, Heard())
        assert gate.drive(now).held is None
    assert len(gate.state.minima) <= 62
    assert gate.drive(now + 0.25, age=0.21).dropped is Reason.STALE


# Whose command


def test_the_commands_of_others_do_not_count():
    gate = Gate().driving()
    assert gate.drive(0.01, Velocity(-0.3, 0.6), OTHER).velocity == SLOW
    assert gate.at(0.02, Command(Velocity(-0.3, 0.6))).velocity == SLOW
    assert gate.state.dropped == {Reason.FOREIGN: 2}


@pytest.mark.parametrize("sequence", [3, 2, 0])
def test_repeated_and_overtaken_commands_do_not_count(sequence):
    gate = Gate().driving()
    verdict = gate.drive(0.01, Velocity(-0.3, 0.6), sequence=sequence)
    assert (verdict.velocity, verdict.dropped) == (SLOW, Reason.REPEATED)


def test_asking_again_does_not_make_old_commands_new():
    gate = Gate().driving()
    gate.enable(0.1)
    assert gate.drive(0.11, sequence=3).dropped is Reason.REPEATED


def test_a_second_driver_is_refused_while_the_first_one_drives():
    gate = Gate().driving()
    verdict = gate.enable(0.1, OTHER)
    assert (verdict.refusal, verdict.velocity) == (Reason.ANOTHER_DRIVER, SLOW)
    gate.at(0.1, Release(OTHER))
    assert gate.state.lease is not None
    gate.at(0.1, Release(ME))
    assert gate.state.ended is None
    assert gate.enable(0.2, OTHER).refusal is None


@pytest.mark.parametrize(
    ("velocity", "reason"),
    [
        (None, Reason.UNREADABLE),
        (Velocity(math.nan, 0.0), Reason.NOT_FINITE),
        (Velocity(0.1, math.inf), Reason.NOT_FINITE),
        (Velocity(-math.inf, 0.0), Reason.NOT_FINITE),
    ],
)
def test_nonsense_from_the_driver_stops_the_rover_until_it_makes_sense(velocity, reason):
    gate = Gate().driving()
    verdict = gate.drive(0.1, velocity)
    assert (verdict.velocity, verdict.held, verdict.dropped) == (ZERO, reason, reason)
    assert gate.drive(0.2).velocity != ZERO


def test_nonsense_from_others_changes_nothing():
    gate = Gate().driving()
    assert gate.drive(0.1, None, OTHER).velocity == SLOW
    assert gate.at(0.1, Command(None)).velocity == SLOW


# Motors


def test_motors_stay_on_until_the_rover_stands():
    gate = Gate().driving()
    gate.at(0.05, Heard(v=0.2))
    assert gate.at(0.1, Release(ME)).motors
    assert gate.at(0.2, Heard(omega=-0.05)).motors
    assert not gate.at(0.3, Heard(v=0.005)).motors
    assert not gate.at(0.4, Heard(v=0.2)).motors


def test_motors_do_not_wait_for_ever():
    gate = Gate().driving()
    gate.at(0.0, Heard(v=0.2))
    gate.at(0.0, Release(ME))
    assert gate.at(1.9, Heard(v=0.2)).motors
    assert not gate.at(2.1, Heard(v=0.2)).motors


# Plain ROS commands


def test_plain_commands_drive_where_they_are_accepted():
    gate = Gate(accept_ros=True)
    gate.at(0.0, Heard(motors_on=False))
    verdict = gate.at(0.1, Command(SLOW))
    assert (verdict.dropped, verdict.motors) == (None, True)
    assert gate.state.lease.driver == ROS_DRIVER
    gate.at(0.2, Heard())
    assert gate.at(0.25, Command(SLOW, age_s=0.05)).velocity != ZERO
    assert gate.enable(0.3).refusal is Reason.ANOTHER_DRIVER


@pytest.mark.parametrize("age_s", [0.31, -0.31, 3600.0, math.nan, math.inf])
def test_plain_commands_of_another_time_do_not_count(age_s):
    gate = Gate(accept_ros=True)
    gate.at(0.0, Heard())
    assert gate.at(0.1, Command(SLOW, age_s=age_s)).dropped is Reason.STALE
    assert gate.state.lease is None


def test_an_old_plain_command_counts_for_less_long():
    gate = Gate(accept_ros=True)
    gate.at(0.0, Heard())
    assert gate.at(0.1, Command(SLOW, age_s=0.2)).held is None
    assert gate.at(0.21, Heard()).held is Reason.SILENCE


def test_a_driver_with_a_lease_has_the_rover_to_itself():
    gate = Gate(accept_ros=True).driving()
    verdict = gate.at(0.01, Command(Velocity(-0.3, 0.6)))
    assert (verdict.velocity, verdict.dropped) == (SLOW, Reason.FOREIGN)


def test_plain_commands_do_not_push_on_after_a_bump():
    gate = Gate(accept_ros=True)
    gate.at(0.0, Heard())
    gate.at(0.0, Command(SLOW))
    gate.at(0.1, Heard(bumped=True))
    assert gate.at(0.15, Command(SLOW)).dropped is Reason.BUMPER
    gate.at(0.2, Heard())
    assert gate.at(0.25, Command(SLOW)).dropped is Reason.NO_LEASE
    assert gate.at(0.3, Command(ZERO)).dropped is None  # the stick is back in the middle
    assert gate.at(0.4, Command(SLOW)).velocity != ZERO


def test_plain_commands_drive_again_after_a_pause():
    gate = Gate(accept_ros=True)
    gate.at(0.0, Heard())
    gate.at(0.0, Command(SLOW))
    gate.at(0.1, Heard(bumped=True))
    gate.at(1.2, Heard())
    assert gate.at(1.2, Command(SLOW)).dropped is None


def test_plain_commands_do_not_drive_a_base_that_is_late():
    gate = Gate(accept_ros=True)
    gate.at(0.0, Heard())
    assert gate.at(0.5, Command(SLOW)).dropped is Reason.ODOMETRY
