"""The gate: a lease that is granted in contact or in a stall allows driving away, nothing else."""

import math

import pytest
from kit.gate_bench import Gate, limits, steps

from bridge.gate.state import Reason
from rover_ncp.core.geometry import STANDSTILL, Velocity

CONTACTS = pytest.mark.parametrize(("bumpers", "toward"), [((2, 0), 1.0), ((0, 2), -1.0)])
AFTER = math.inf


def touching(*, now=9.0, **report):
    """A gate whose base touches something, under a lease that was granted in that."""
    gate = Gate().driving(now)
    gate.keep(now + 0.01, **report)
    assert gate.enable(now + 0.1).refusal is None
    return gate


@CONTACTS
def test_pressed_bumper_holds_motion_toward_it_and_turns(bumpers, toward):
    gate = touching(bumpers=bumpers)
    velocities = [(0.1, 0.0), (1e-9, 0.0), (0.0, 0.3), (0.0, -0.3), (0.3, -0.6)]
    for number, (v, omega) in enumerate(velocities):
        verdict = gate.drive(9.2 + 0.1 * number, Velocity(toward * v, omega))
        assert (verdict.velocity, verdict.held, verdict.dropped) == (STANDSTILL, Reason.BUMPER, None)
    assert verdict.lease.number == 2


@CONTACTS
@pytest.mark.parametrize(("v_max", "got"), [(0.3, 0.1), (0.05, 0.05)])
def test_pressed_bumper_allows_driving_straight_away_slowly(bumpers, toward, v_max, got):
    gate = touching(bumpers=bumpers)
    gate.limits = limits(v_max=v_max)
    for now in steps(9.2, 12.2, 0.05):  # as long as it takes
        verdict = gate.drive(now, Velocity(-toward * 0.2, 0.3))
    assert (verdict.velocity, verdict.held) == ((-toward * got, 0.0), None)
    assert gate.state.limited == {Reason.SPEED: 61, Reason.TURN: 61}
    assert gate.drive(12.25, Velocity(-toward * 0.04, 0.0)).velocity == (-toward * 0.04, 0.0)
    assert gate.drive(12.3, Velocity(toward * 0.04, 0.0)).held is Reason.BUMPER
    assert gate.drive(12.35, STANDSTILL).held is None


@pytest.mark.parametrize("contact", [{"bumpers": (2, 2)}, {"bumpers": (1, 0), "stalled": (True, False)}])
def test_contact_on_both_sides_refuses_the_lease(contact):
    gate = Gate()
    gate.report(8.9, v=-0.1)
    gate.report(9.0, **contact)
    assert gate.enable(9.0).refusal is Reason.BUMPER


@pytest.mark.parametrize(
    ("more", "reason"),
    [
        ({"bumpers": (3, 0)}, Reason.BUMPER),
        ({"bumpers": (1, 0)}, Reason.BUMPER),
        ({"bumpers": (2, 2)}, Reason.BUMPER),
        ({"bumpers": (2, 0), "stalled": (False, True)}, Reason.STALL),
    ],
)
def test_more_contact_while_driving_away_ends_the_lease(more, reason):
    gate = touching(bumpers=(2, 0))
    for now in steps(9.2, 9.7, 0.05):
        gate.drive(now, Velocity(-0.2, 0.3))
    verdict = gate.report(9.72, **more)
    assert (verdict.velocity, verdict.held, gate.state.lease_over) == (STANDSTILL, reason, reason)


@CONTACTS
def test_freed_rover_drives_toward_the_contact_only_after_another_command(bumpers, toward):
    gate = touching(bumpers=bumpers)
    for now in steps(9.2, 9.4, 0.05):
        gate.drive(now, Velocity(toward * 0.1, 0.0))
    gate.keep(9.45)
    for now in steps(9.45, 9.65, 0.05):
        assert gate.drive(now, Velocity(toward * 0.1, 0.0)).held is Reason.BUMPER
    assert gate.drive(9.7, STANDSTILL).held is None
    for now in steps(9.75, 10.05, 0.05):
        verdict = gate.drive(now, Velocity(toward * 0.2, 0.3))
    assert verdict.velocity == (toward * 0.2, 0.3)
    assert gate.report(10.1, bumpers=bumpers).lease is None


@pytest.mark.parametrize(
    ("commanded", "reported", "free"),
    [
        (0.1, 0.1, -1.0),
        (0.1, 0.0, -1.0),
        (-0.1, -0.1, 1.0),
        (0.0, 0.01, -1.0),
        (0.0, -0.01, 1.0),
        (0.009, 0.0, None),
        (0.1, -0.01, None),
    ],
)
@pytest.mark.parametrize("stalled", [(True, False), (False, True)])
def test_stalled_rover_may_drive_back_from_where_it_was_moving_if_that_is_known(
    commanded, reported, free, stalled
):
    gate = Gate().driving(9.0)
    for now, x in ((9.1, 0.01), (9.2, 0.02)):
        gate.report(now, x=x, v=reported)
        gate.drive(now, Velocity(commanded, 0.1))
    assert gate.report(9.22, stalled=stalled).held is Reason.STALL
    assert gate.state.lease_over is Reason.STALL
    assert gate.drive(9.23, Velocity(-0.2, 0.3)).dropped is Reason.STALL
    gate.report(9.3, stalled=stalled)
    assert gate.enable(9.3).refusal is (Reason.STALL if free is None else None)
    if free is not None:
        for now in (9.4, 9.5):
            gate.report(now, stalled=stalled)
            verdict = gate.drive(now, Velocity(free * 0.1, 0.1))
        assert (verdict.velocity, verdict.held) == (pytest.approx((free * 0.1, 0.0)), None)
        gate.drive(9.6, Velocity(-free * 0.1, 0.1))
        verdict = gate.report(9.7, stalled=stalled)
        assert (verdict.velocity, verdict.held) == (STANDSTILL, Reason.STALL)


def test_stall_of_a_rover_that_was_not_seen_to_move_refuses_the_lease():
    gate = Gate()
    gate.report(0.0, stalled=(True, True))
    assert gate.enable(0.0).refusal is Reason.STALL
    gate.report(0.1, v=0.1)
    gate.lost(0.2)
    gate.report(0.3, stalled=(True, True))
    assert gate.enable(0.3).refusal is Reason.STALL


@pytest.mark.parametrize("renewed", [False, True])
def test_stall_keeps_its_side_and_must_end_within_exactly_this_time(renewed):
    gate = touching(stalled=(True, True))
    for now in steps(9.2, 9.9, 0.05):
        verdict = gate.drive(now, Velocity(-0.2, 0.3))
    assert verdict.velocity == (-0.1, 0.0)
    assert gate.drive(9.95, Velocity(0.1, 0.0)).held is Reason.STALL
    assert gate.drive(9.96, Velocity(-0.2, 0.0)).held is None
    if renewed:
        assert gate.renew(10.1).refusal is None
    assert gate.tick(10.1).held in {None, Reason.SILENCE}
    assert gate.tick(math.nextafter(10.1, AFTER)).held is Reason.STALL


def test_stall_that_ends_and_begins_again_ends_the_lease():
    gate = touching(stalled=(True, True))
    for now in steps(9.2, 9.9, 0.05):
        gate.drive(now, Velocity(-0.2, 0.3))
    gate.keep(9.92, v=-0.1)
    assert gate.drive(9.92, Velocity(-0.2, 0.3)).held is None
    assert gate.report(9.95, stalled=(True, False)).held is Reason.STALL
