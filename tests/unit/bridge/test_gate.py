"""The gate: what it takes to drive, the limits, and the hazards that end a drive."""

import math
from dataclasses import replace

import pytest
from gate_bench import LIMITS, SLOW, Gate

from bridge.base import BaseReport
from bridge.gate.limits import Fence
from bridge.gate.state import (
    ZERO,
    BaseLost,
    Reason,
    ReleaseStop,
    Stop,
    Tick,
)
from rover_ncp.core.geometry import Velocity

# What it takes to drive


def test_nothing_moves_before_the_first_base_report():
    gate = Gate()
    assert gate.at(0.0, Tick()).held is Reason.NO_BASE
    assert gate.enable(0.1).refusal is Reason.NO_BASE
    verdict = gate.drive(0.2)
    assert (verdict.velocity, verdict.motors, verdict.dropped) == (ZERO, False, Reason.NO_BASE)


def test_nothing_moves_without_a_lease():
    gate = Gate()
    gate.at(0.0, BaseReport(motors_on=True))
    verdict = gate.drive(0.1)
    assert (verdict.velocity, verdict.motors) == (ZERO, False)
    assert (verdict.held, verdict.dropped) == (Reason.NO_LEASE, Reason.NO_LEASE)


def test_nothing_moves_before_the_motors_are_on():
    gate = Gate()
    gate.at(0.0, BaseReport(motors_on=False))
    assert gate.enable(0.1).motors
    verdict = gate.drive(0.2)
    assert (verdict.velocity, verdict.held) == (ZERO, Reason.MOTORS_OFF)
    gate.at(0.25, BaseReport())
    assert gate.drive(0.3).velocity.v > 0.0


def test_stale_odometry_refuses_the_lease():
    gate = Gate()
    gate.at(0.0, BaseReport())
    assert gate.enable(0.5).refusal is Reason.ODOMETRY
    gate.at(0.6, BaseReport())
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


def test_delayed_loop_gains_no_acceleration():
    gate = Gate(LIMITS.model_copy(update={"command_timeout_s": 0.4}))
    gate.driving()
    gate.at(0.25, BaseReport())
    gate.state = replace(gate.state, now=0.0, out=ZERO)
    assert gate.drive(0.3, Velocity(0.3, 0.0)).velocity.v == pytest.approx(0.1)


FENCE = LIMITS.model_copy(
    update={"fence": Fence(x_min=-1.0, x_max=2.0, y_min=-1.0, y_max=1.0), "brake": 0.25}
)


@pytest.mark.parametrize(
    ("base", "velocity", "passes"),
    [
        (BaseReport(x=0.0), Velocity(0.1, 0.0), True),
        # 0.1 m/s reaches 0.03 m while it reacts and 0.02 m while it brakes; half of it at a slant.
        (BaseReport(x=1.949), Velocity(0.1, 0.0), True),
        (BaseReport(x=1.951), Velocity(0.1, 0.0), False),
        (BaseReport(x=1.974, theta=math.pi / 3), Velocity(0.1, 0.0), True),
        (BaseReport(x=1.976, theta=math.pi / 3), Velocity(0.1, 0.0), False),
        (BaseReport(y=0.974, theta=math.pi / 6), Velocity(0.1, 0.0), True),
        (BaseReport(y=0.976, theta=math.pi / 6), Velocity(0.1, 0.0), False),
        (BaseReport(x=1.965), Velocity(-0.1, 0.0), True),
        (BaseReport(x=1.965), Velocity(0.0, 0.3), True),
        (BaseReport(x=1.965, theta=math.pi), Velocity(0.1, 0.0), True),
        (BaseReport(x=-0.99, theta=math.pi), Velocity(0.1, 0.0), False),
        (BaseReport(y=0.99, theta=math.pi / 2), Velocity(0.1, 0.0), False),
        (BaseReport(y=-0.99, theta=math.pi / 2), Velocity(-0.1, 0.0), False),
        (BaseReport(x=2.5), Velocity(0.1, 0.0), False),
        (BaseReport(x=2.5), Velocity(-0.1, 0.0), True),
        (BaseReport(x=2.5, theta=math.pi / 2), Velocity(0.1, 0.0), False),
    ],
)
def test_fence_holds_motion_outward_only(base, velocity, passes):
    gate = Gate(FENCE).driving()
    gate.place(0.1, base)
    verdict = gate.drive(0.1, velocity)
    assert verdict.held is (None if passes else Reason.GEOFENCE)
    if not passes:
        assert verdict.velocity == ZERO
        assert gate.state.stops == {Reason.GEOFENCE: 1}
        assert gate.drive(0.15, ZERO).held is None  # a hold, not the end of the lease


SONAR = LIMITS.model_copy(update={"sonar_stop_m": 0.4})
NEARER = math.nextafter(0.4, 0.0)


@pytest.mark.parametrize(
    ("ahead_m", "behind_m", "velocity", "passes"),
    [
        (0.4, NEARER, Velocity(0.1, 0.0), True),
        (NEARER, 5.0, Velocity(0.1, 0.0), False),
        (5.0, NEARER, Velocity(1e-9, 0.3), True),
        (NEARER, 0.4, Velocity(-0.1, 0.0), True),
        (5.0, NEARER, Velocity(-0.1, 0.0), False),
        (NEARER, NEARER, Velocity(0.0, 0.3), True),
        (math.nan, 5.0, Velocity(0.1, 0.0), False),
        (math.nan, 5.0, Velocity(-0.1, 0.0), True),
        (5.0, math.nan, Velocity(-0.1, 0.0), False),
        (math.inf, math.nan, Velocity(0.1, 0.0), True),
    ],
)
def test_sonars_hold_motion_toward_an_obstacle_only(ahead_m, behind_m, velocity, passes):
    gate = Gate().driving()
    gate.limits = SONAR
    gate.at(0.1, BaseReport(clear_ahead_m=ahead_m, clear_behind_m=behind_m))
    verdict = gate.drive(0.1, velocity)
    assert verdict.held is (None if passes else Reason.SONAR)
    if not passes:
        assert verdict.velocity == ZERO
        assert not verdict.emergency
        assert gate.state.stops == {Reason.SONAR: 1}
        assert gate.drive(0.15, Velocity(0.0, 0.2)).held is None  # a hold, not the end of the lease


def test_sonars_hold_nothing_without_sonar_stop_m():
    gate = Gate().driving()
    gate.at(0.1, BaseReport(clear_ahead_m=0.01, clear_behind_m=math.nan))
    assert gate.drive(0.1).held is None


# Hazards


HAZARDS = [
    (BaseReport(stop_pressed=True), Reason.STOP_BUTTON),
    (BaseReport(bumpers=(1, 2)), Reason.BUMPER),
]


@pytest.mark.parametrize(("event", "reason"), [*HAZARDS, (BaseLost(), Reason.NO_BASE)])
def test_a_hazard_stops_and_ends_the_lease(event, reason):
    gate = Gate().driving()
    verdict = gate.at(0.01, event)
    assert (verdict.velocity, verdict.held) == (ZERO, reason)
    assert gate.state.lease is None
    assert gate.state.lease_over is reason
    assert gate.state.stops == {reason: 1}
    assert gate.drive(0.02).dropped is reason
    assert gate.enable(0.03).refusal is reason
    assert gate.at(0.1, BaseReport()).velocity == ZERO
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
def test_only_stop_button_bumper_and_stall_brake_harder(reason, emergency):
    gate = Gate().driving()
    events = {value: event for event, value in HAZARDS}
    events |= {Reason.STOPPED: Stop("now"), Reason.STALL: BaseReport(stalled=(False, True))}
    verdict = gate.at(0.35, BaseReport())
    if reason is Reason.NO_LEASE:
        verdict = gate.release(0.35)
    elif reason in events:
        verdict = gate.at(0.35, events[reason])
    assert verdict.held is reason
    assert verdict.emergency is emergency


def test_stop_is_latched_until_released_and_needs_a_new_lease():
    gate = Gate().driving()
    assert gate.at(0.0, Stop("child on the floor")).velocity == ZERO
    assert gate.state.stop_reason == "child on the floor"
    gate.at(0.1, BaseReport())
    assert gate.drive(0.1).dropped is Reason.STOPPED
    assert gate.enable(0.2).refusal is Reason.STOPPED
    assert gate.at(0.2, ReleaseStop()).velocity == ZERO
    assert gate.drive(0.2).dropped is Reason.NO_LEASE
    assert gate.enable(0.3).refusal is None


def test_hazard_after_a_release_is_not_its_reason():
    gate = Gate().driving()
    gate.release(0.05)
    assert gate.at(0.1, BaseReport(bumpers=(1, 0))).held is Reason.BUMPER
    assert gate.state.lease_over is None
    assert gate.state.stops == {}


def test_low_battery_is_a_hazard_only_when_it_lasts():
    gate = Gate().driving()
    low, fine = BaseReport(battery_v=10.9), BaseReport(battery_v=11.0)
    for k, report in enumerate([low] * 19 + [fine] + [low] * 20):
        gate.at(0.1 * k, report)
        assert gate.drive(0.1 * k).held is None
    gate.at(4.0, low)
    assert gate.drive(4.0).dropped is Reason.LOW_BATTERY
    assert gate.enable(4.0).refusal is Reason.LOW_BATTERY


def test_a_base_that_reports_no_voltage_is_not_low():
    gate = Gate().driving()
    for k in range(40):
        gate.at(0.1 * k, BaseReport(battery_v=0.0))
        assert gate.drive(0.1 * k).held is None


def test_motors_that_go_off_by_themselves_end_the_lease():
    gate = Gate().driving()
    for k in range(1, 10):
        gate.at(0.1 * k, BaseReport())
        gate.drive(0.1 * k)
    verdict = gate.at(1.0, BaseReport(motors_on=False))
    assert (verdict.velocity, verdict.held, verdict.motors) == (ZERO, Reason.MOTORS_OFF, False)
    assert gate.state.lease_over is Reason.MOTORS_OFF


def test_motors_that_never_come_on_end_the_lease():
    gate = Gate()
    gate.at(0.0, BaseReport(motors_on=False))
    gate.enable(0.0)
    for k in range(1, 11):
        gate.at(0.1 * k, BaseReport(motors_on=False))
        assert gate.drive(0.1 * k).dropped is None
    gate.at(1.05, BaseReport(motors_on=False))
    assert gate.drive(1.05).dropped is Reason.NO_LEASE
    assert gate.state.lease_over is Reason.MOTORS_OFF


# Motors


def test_motors_stay_on_until_the_rover_stands():
    gate = Gate().driving()
    gate.at(0.05, BaseReport(v=0.2))
    assert gate.release(0.1).motors
    assert gate.at(0.2, BaseReport(omega=-0.05)).motors
    assert not gate.at(0.3, BaseReport(v=0.005)).motors
    assert not gate.at(0.4, BaseReport(v=0.2)).motors


def test_motors_go_off_at_the_latest_after_the_coasting_time():
    gate = Gate().driving()
    gate.at(0.0, BaseReport(v=0.2))
    gate.release(0.0)
    assert gate.at(1.9, BaseReport(v=0.2)).motors
    assert not gate.at(2.1, BaseReport(v=0.2)).motors
