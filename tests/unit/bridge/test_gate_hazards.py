"""The gate: nothing moves before all is there; limits, fence, sonars, hazards and motors."""

import math

import pytest
from kit.gate_bench import BOX, SLOW, Gate, limits, steps

from bridge.base import BaseReport
from bridge.gate.state import Reason
from rover_ncp.core.geometry import STANDSTILL, Velocity


def test_nothing_moves_without_base_lease_and_motors():
    gate = Gate()
    assert gate.tick(0.0).held is Reason.NO_BASE
    assert gate.enable(0.1).refusal is Reason.NO_BASE
    verdict = gate.drive(0.2)
    assert (verdict.velocity, verdict.motors) == (STANDSTILL, False)
    assert verdict.dropped is Reason.NO_BASE
    gate.report(0.3, motors_on=False)
    verdict = gate.drive(0.3)
    assert (verdict.velocity, verdict.motors) == (STANDSTILL, False)
    assert (verdict.held, verdict.dropped) == (Reason.NO_LEASE, Reason.NO_LEASE)
    assert gate.enable(0.4).motors
    verdict = gate.drive(0.5)
    assert (verdict.velocity, verdict.held) == (STANDSTILL, Reason.MOTORS_OFF)
    gate.report(0.55)
    assert gate.drive(0.6).velocity != STANDSTILL


def test_command_in_force_stays_and_counts():
    gate = Gate().driving()
    assert gate.tick(0.2).velocity == SLOW
    assert (gate.state.accepted, gate.state.dropped, gate.state.stops) == (3, {}, {})


@pytest.mark.parametrize(
    ("asked", "got", "limited"),
    [
        ((0.3, 0.0), (0.3, 0.0), {}),
        ((-0.3, 0.0), (-0.3, 0.0), {}),
        ((math.nextafter(0.3, 1.0), 0.0), (0.3, 0.0), {Reason.SPEED: 3}),
        ((-1e300, 0.0), (-0.3, 0.0), {Reason.SPEED: 3}),
        ((0.0, 0.6), (0.0, 0.6), {}),
        ((0.0, 7.0), (0.0, 0.6), {Reason.TURN: 3}),
        ((0.0, -7.0), (0.0, -0.6), {Reason.TURN: 3}),
    ],
)
def test_speeds_are_cut_to_the_limits(asked, got, limited):
    gate = Gate(limits(accel=5.0, alpha=20.0)).driving()
    for now in steps(0.1, 0.3, 0.1):
        verdict = gate.drive(now, Velocity(*asked))
    assert (verdict.velocity, gate.state.limited) == (got, limited)


def test_speeds_grow_no_faster_than_allowed_and_brake_at_once():
    gate = Gate().driving()
    assert gate.drive(0.04, Velocity(0.3, -0.6)).velocity == pytest.approx((0.14, -0.26))
    assert gate.tick(0.06).velocity == pytest.approx((0.16, -0.34))
    assert gate.drive(0.06, Velocity(0.02, 0.0)).velocity == (0.02, 0.0)
    assert gate.drive(0.08, Velocity(-0.3, 0.0)).velocity == pytest.approx((-0.02, 0.0))


def test_delayed_loop_gains_no_acceleration():
    gate = Gate(limits(command_timeout_s=0.1)).driving()
    assert gate.tick(0.11).held is Reason.SILENCE
    assert gate.drive(0.35, Velocity(0.3, 0.0)).velocity == pytest.approx((0.1, 0.0))


@pytest.mark.parametrize(
    ("base", "velocity", "held"),
    [
        ({"x": 0.0}, (0.1, 0.0), None),
        ({"x": 1.949}, (0.1, 0.0), None),
        ({"x": 1.951}, (0.1, 0.0), Reason.GEOFENCE),
        ({"x": 1.974, "theta": math.pi / 3}, (0.1, 0.0), None),
        ({"x": 1.976, "theta": math.pi / 3}, (0.1, 0.0), Reason.GEOFENCE),
        ({"x": -0.99, "theta": math.pi}, (0.1, 0.0), Reason.GEOFENCE),
        ({"y": -0.99, "theta": math.pi / 2}, (-0.1, 0.0), Reason.GEOFENCE),
        ({"x": 1.965}, (-0.1, 0.0), None),
        ({"x": 2.5}, (0.1, 0.0), Reason.GEOFENCE),
        ({"x": 2.5}, (-0.1, 0.0), None),
        ({"x": 2.5, "theta": math.pi / 2}, (0.1, 0.0), Reason.GEOFENCE),
    ],
)
def test_fence_holds_motion_outward_and_lets_the_rover_move_inside_and_back(base, velocity, held):
    gate = Gate(limits(fence=BOX, brake=0.25)).driving()
    gate.place(0.1, BaseReport(**base))
    verdict = gate.drive(0.1, Velocity(*velocity))
    assert verdict.held is held
    assert held is None or verdict.velocity == STANDSTILL
    assert held is None or gate.state.stops == {held: 1}
    assert gate.drive(0.15, STANDSTILL).held is None


@pytest.mark.parametrize(
    ("ahead", "behind", "velocity", "held"),
    [
        (0.4, 0.39, (0.1, 0.0), None),
        (math.nextafter(0.4, 0.0), 5.0, (0.1, 0.0), Reason.SONAR),
        (0.39, 0.4, (-0.1, 0.0), None),
        (5.0, math.nextafter(0.4, 0.0), (-0.1, 0.0), Reason.SONAR),
        (0.3, 0.3, (0.0, 0.3), None),
        (5.0, 0.3, (1e-9, 0.3), None),
        (math.nan, 5.0, (0.1, 0.0), Reason.SONAR),
        (math.nan, 5.0, (-0.1, 0.0), None),
        (5.0, math.nan, (-0.1, 0.0), Reason.SONAR),
        (math.inf, math.nan, (0.1, 0.0), None),
    ],
)
def test_sonars_hold_motion_toward_an_obstacle_and_nothing_else(ahead, behind, velocity, held):
    gate = Gate().driving()
    gate.report(0.1, clear_ahead_m=0.01, clear_behind_m=0.01)
    assert gate.drive(0.1).held is None  # without sonar_stop_m
    gate.limits = limits(sonar_stop_m=0.4)
    gate.report(0.1, clear_ahead_m=ahead, clear_behind_m=behind)
    verdict = gate.drive(0.1, Velocity(*velocity))
    assert verdict.held is held
    assert held is None or verdict.velocity == STANDSTILL
    assert not verdict.emergency
    assert gate.drive(0.15, Velocity(0.0, 0.2)).held is None


def report(**fields):
    return lambda gate, now: gate.report(now, **fields)


@pytest.mark.parametrize(
    ("happen", "reason", "emergency"),
    [
        (report(stop_pressed=True), Reason.STOP_BUTTON, True),
        (report(bumpers=(1, 2)), Reason.BUMPER, True),
        (lambda gate, now: gate.stop(now, "smoke"), Reason.STOPPED, True),
        (lambda gate, now: gate.lost(now), Reason.NO_BASE, False),
    ],
)
def test_hazard_stops_the_rover_and_ends_the_lease_until_it_is_over(happen, reason, emergency):
    gate = Gate().driving()
    verdict = happen(gate, 0.01)
    assert (verdict.velocity, verdict.held, verdict.lease) == (STANDSTILL, reason, None)
    assert (verdict.emergency, gate.state.lease_over, gate.state.stops) == (emergency, reason, {reason: 1})
    assert gate.drive(0.02).dropped is reason
    assert gate.enable(0.03).refusal is reason
    gate.unstop(0.05)
    assert gate.report(0.1).velocity == STANDSTILL
    assert gate.drive(0.11).dropped is Reason.NO_LEASE
    assert gate.enable(0.12).refusal is None
    assert gate.state.lease_over is None
    assert gate.drive(0.2).velocity != STANDSTILL


@pytest.mark.parametrize(
    ("contact", "reason"),
    [
        *(({"bumpers": bumpers}, Reason.BUMPER) for bumpers in [(1, 0), (2, 0), (0, 1), (0, 2)]),
        *(({"stalled": stalled}, Reason.STALL) for stalled in [(False, True), (True, False)]),
    ],
)
def test_every_contact_ends_the_lease_and_brakes_harder(contact, reason):
    gate = Gate().driving()
    verdict = gate.report(0.01, **contact)
    assert (verdict.held, verdict.emergency, gate.state.lease_over) == (reason, True, reason)


def test_low_battery_is_a_hazard_only_when_it_lasts():
    gate = Gate().driving()
    for now in [*steps(0.0, 1.8, 0.1), 1.9, *steps(2.0, 3.9, 0.1)]:
        gate.report(now, battery_v=11.0 if now == 1.9 else 10.9)
        assert gate.drive(now).held is None
    gate.report(4.0, battery_v=10.9)
    assert gate.drive(4.0).dropped is Reason.LOW_BATTERY
    assert gate.enable(4.0).refusal is Reason.LOW_BATTERY


@pytest.mark.parametrize(("volts", "held"), [(0.0, None), (0.5, Reason.LOW_BATTERY)])
def test_voltage_of_zero_is_not_known_and_any_other_is(volts, held):
    gate = Gate().driving()
    for now in steps(0.0, 2.0, 0.1):
        gate.report(now, battery_v=volts)
        gate.drive(now)
    assert gate.report(2.0, battery_v=volts).held is held


def test_reconnected_base_has_time_to_recover_its_voltage():
    gate = Gate()
    gate.report(0.0, battery_v=10.0)
    gate.lost(1.5)
    gate.report(1.6, battery_v=10.0)
    assert gate.report(3.0, battery_v=10.0).held is Reason.NO_LEASE
    assert gate.report(3.6, battery_v=10.0).held is Reason.LOW_BATTERY


def test_motors_that_go_off_by_themselves_end_the_lease():
    gate = Gate().driving()
    for now in steps(0.1, 0.9, 0.1):
        gate.report(now)
        gate.drive(now)
    verdict = gate.report(1.0, motors_on=False)
    assert (verdict.velocity, verdict.held, verdict.motors) == (STANDSTILL, Reason.MOTORS_OFF, False)
    assert gate.state.lease_over is Reason.MOTORS_OFF


def test_motors_that_never_come_on_end_the_lease_after_a_second():
    gate = Gate()
    gate.report(0.0, motors_on=False)
    gate.enable(0.0)
    for now in steps(0.1, 1.0, 0.1):
        gate.report(now, motors_on=False)
        assert gate.drive(now).dropped is None
    gate.report(1.05, motors_on=False)
    assert gate.drive(1.05).dropped is Reason.NO_LEASE
    assert gate.state.lease_over is Reason.MOTORS_OFF


def test_motors_stay_on_until_the_rover_stands():
    gate = Gate().driving()
    gate.report(0.05, v=0.2)
    assert gate.release(0.1).motors
    assert gate.report(0.2, omega=-0.05).motors
    assert not gate.report(0.3, v=0.005).motors
    assert not gate.report(0.4, v=0.2).motors


@pytest.mark.parametrize("hazard", [{}, {"stop_pressed": True}])
@pytest.mark.parametrize(("field", "speed"), [("v", 0.01), ("v", -0.01), ("omega", 0.01)])
def test_motors_of_a_rover_that_moves_go_off_after_exactly_two_seconds(field, speed, hazard):
    gate = Gate().driving(1.0)
    gate.report(1.0, **{field: speed}, **hazard)
    gate.release(1.0)
    assert gate.tick(math.nextafter(3.0, 0.0)).motors
    assert not gate.tick(3.0).motors
