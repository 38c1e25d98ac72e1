"""The gate: a rover that touches something may be driven straight away from it, and nowhere else."""

import math

import pytest
from gate_bench import LIMITS, Gate

from bridge.base import BaseReport
from bridge.gate.state import ZERO, BaseLost, Enable, Reason, VelocityCommand
from rover_ncp.core.geometry import Velocity

FRONT, REAR = BaseReport(bumpers=(2, 0)), BaseReport(bumpers=(0, 2))
BOTH = BaseReport(bumpers=(2, 2))
AWAY = Velocity(-0.2, 0.3)


class Reporting(Gate):
    """A gate whose base repeats ``report``, if there is one, before each command and request."""

    report = None

    def at(self, now, event):
        if self.report is not None and isinstance(event, Enable | VelocityCommand):
            super().at(now, self.report)
        return super().at(now, event)

    def keep(self, begin, seconds, velocity):
        """Commands at 20 Hz; return the last verdict."""
        for k in range(round(seconds * 20) + 1):
            verdict = self.drive(begin + 0.05 * k, velocity)
        return verdict


def in_contact(report):
    """A gate whose driver lost the lease in contact while it drove forward, and got it again."""
    gate = Reporting().driving(9.0)
    if report.bumpers[1]:
        gate.keep(9.0, 0.0, Velocity(-0.1, 0.0))
    gate.report = report
    assert gate.at(9.01, report).velocity == ZERO
    assert gate.state.lease is None
    gate.sequence = 0
    assert gate.enable(9.1).refusal is None
    return gate


@pytest.mark.parametrize(("report", "sign"), [(FRONT, 1.0), (REAR, -1.0)])
@pytest.mark.parametrize("velocity", [(0.1, 0.0), (1e-9, 0.0), (0.0, 0.3), (0.0, -0.3), (0.3, -0.6)])
def test_pressed_bumper_holds_motion_toward_it_and_turns(report, sign, velocity):
    gate = in_contact(report)
    v, omega = velocity
    verdict = gate.keep(9.2, 0.5, Velocity(sign * v, omega))
    assert (verdict.velocity, verdict.held, verdict.dropped) == (ZERO, Reason.BUMPER, None)
    assert gate.state.lease is not None


@pytest.mark.parametrize(("report", "sign"), [(FRONT, -1.0), (REAR, 1.0)])
@pytest.mark.parametrize(("v_max", "got"), [(0.3, 0.1), (0.05, 0.05)])
def test_pressed_bumper_allows_driving_straight_away_slowly(report, sign, v_max, got):
    gate = in_contact(report)
    gate.limits = LIMITS.model_copy(update={"v_max": v_max})
    before = dict(gate.state.limited)
    verdict = gate.keep(9.2, 0.5, Velocity(sign * 0.2, 0.3))
    assert (verdict.velocity, verdict.held) == ((sign * got, 0.0), None)
    assert gate.state.limited[Reason.SPEED] == before.get(Reason.SPEED, 0) + 11
    assert gate.state.limited[Reason.TURN] == before.get(Reason.TURN, 0) + 11
    assert gate.drive(9.75, Velocity(sign * 0.04, 0.0)).velocity == (sign * 0.04, 0.0)
    assert gate.drive(9.8, Velocity(-sign * 0.04, 0.0)).held is Reason.BUMPER
    assert gate.drive(9.85, ZERO).held is None


@pytest.mark.parametrize("report", [BOTH, BaseReport(bumpers=(1, 0), stalled=(True, False))])
def test_contact_on_both_sides_refuses_the_lease(report):
    gate = Gate()
    gate.at(8.9, BaseReport(v=-0.1))  # the stall is on the other side than the bumper
    gate.at(9.0, report)
    assert gate.enable(9.0).refusal is Reason.BUMPER
    assert gate.enable(9.1).velocity == ZERO


@pytest.mark.parametrize(
    "report", [BaseReport(bumpers=(3, 0)), BOTH, BaseReport(bumpers=(2, 0), stalled=(False, True))]
)
def test_more_contact_while_driving_away_ends_the_lease(report):
    gate = in_contact(FRONT)
    assert gate.keep(9.2, 0.5, AWAY).velocity == (-0.1, 0.0)
    gate.report = report
    verdict = gate.at(9.72, report)
    reason = Reason.STALL if any(report.stalled) else Reason.BUMPER
    assert (verdict.velocity, verdict.held, gate.state.lease_over) == (ZERO, reason, reason)


def test_other_front_segment_than_before_ends_the_lease():
    gate = in_contact(REAR)
    gate.keep(9.2, 0.1, Velocity(0.1, 0.0))
    assert gate.at(9.32, BaseReport(bumpers=(0, 1))).held is Reason.BUMPER
    assert gate.state.lease is None


@pytest.mark.parametrize(("report", "sign"), [(FRONT, -1.0), (REAR, 1.0)])
def test_freed_rover_drives_toward_the_contact_only_after_another_command(report, sign):
    gate = in_contact(report)
    gate.keep(9.2, 0.2, Velocity(-sign * 0.1, 0.0))
    gate.report = BaseReport()
    assert gate.keep(9.45, 0.2, Velocity(-sign * 0.1, 0.0)).held is Reason.BUMPER
    assert gate.drive(9.7, ZERO).held is None
    assert gate.keep(9.75, 0.3, Velocity(-sign * 0.2, 0.3)).velocity == (-sign * 0.2, 0.3)
    assert gate.at(10.1, report).held is Reason.BUMPER
    assert gate.state.lease is None


def test_released_bumper_lifts_the_limits_and_ends_the_lease_when_pressed_again():
    gate = in_contact(FRONT)
    gate.keep(9.2, 0.3, AWAY)
    gate.report = BaseReport()
    assert gate.keep(9.55, 0.3, AWAY).velocity == AWAY
    gate.report = FRONT
    assert gate.at(9.9, FRONT).held is Reason.BUMPER
    assert gate.state.lease_over is Reason.BUMPER


def test_one_of_two_segments_that_is_released_is_guarded_again():
    gate = in_contact(BaseReport(bumpers=(3, 0)))
    gate.keep(9.2, 0.1, AWAY)
    gate.report = FRONT
    assert gate.keep(9.35, 0.1, AWAY).held is None
    assert gate.at(9.5, BaseReport(bumpers=(3, 0))).held is Reason.BUMPER


def test_renewal_keeps_the_contact_of_the_lease():
    gate = in_contact(FRONT)
    gate.keep(9.2, 0.1, AWAY)
    gate.at(9.35, FRONT)
    assert gate.renew(9.35).refusal is None
    assert gate.drive(9.4, Velocity(0.1, 0.0)).held is Reason.BUMPER
    assert gate.keep(9.45, 0.3, AWAY).velocity == (-0.1, 0.0)


def test_renewal_permits_no_new_contact():
    gate = Gate().driving(9.0)
    gate.state = gate.state.__class__(**{**vars(gate.state), "base": FRONT})
    gate.sequence += 1
    stamp = gate.stamp(9.0)
    assert gate.at(9.0, Enable("deploy", stamp, bytes(32), gate.sequence)).refusal is Reason.BUMPER
    assert gate.state.lease is None


# Stall


@pytest.mark.parametrize(
    ("commanded", "reported", "free"),
    [
        (0.1, 0.1, -0.1),
        (0.1, 0.0, -0.1),
        (0.1, 0.009, -0.1),
        (0.1, -0.009, -0.1),
        (-0.1, -0.1, 0.1),
        (-0.1, 0.0, 0.1),
        (0.0, 0.01, -0.1),
        (0.0, -0.01, 0.1),
        (0.0, 0.009, None),
        (0.009, 0.0, None),
        (0.01, 0.0, -0.1),
        (0.1, -0.01, None),
        (-0.1, 0.01, None),
    ],
)
@pytest.mark.parametrize("stalled", [(True, False), (False, True)])
def test_stalled_rover_may_drive_back_from_where_it_was_moving(commanded, reported, free, stalled):
    gate = Gate().driving(9.0)
    report = BaseReport(stalled=stalled)
    for k in range(1, 5):
        gate.at(9.0 + 0.05 * k, BaseReport(x=0.01 * k, v=reported))
        gate.drive(9.0 + 0.05 * k, Velocity(commanded, 0.1))
    assert gate.at(9.22, report).held is Reason.STALL
    assert gate.state.lease_over is Reason.STALL
    assert gate.drive(9.23, AWAY).dropped is Reason.STALL
    gate.at(9.3, report)
    gate.sequence = 0
    assert gate.enable(9.3).refusal is (Reason.STALL if free is None else None)
    for now, v in ((9.4, -0.1), (9.6, 0.1)):
        gate.at(now, report)
        gate.drive(now, Velocity(v, 0.1))
        verdict = gate.at(now + 0.1, report)
        passes = v == free
        assert verdict.velocity == ((pytest.approx(v), 0.0) if passes else ZERO)
        assert verdict.held is (None if passes else Reason.STALL)


def test_stall_is_on_the_side_of_the_newest_command():
    gate = Gate().driving(9.0)
    gate.drive(9.02, Velocity(-0.1, 0.0))
    gate.at(9.1, BaseReport(stalled=(True, True)))
    gate.sequence = 0
    assert gate.enable(9.1).refusal is None
    assert gate.drive(9.12, Velocity(-0.1, 0.0)).held is Reason.STALL
    assert gate.drive(9.14, Velocity(0.1, 0.0)).held is None


def test_stall_of_a_rover_that_was_never_seen_to_move_refuses_the_lease():
    gate = Gate()
    gate.at(0.0, BaseReport(stalled=(True, True)))
    assert gate.enable(0.0).refusal is Reason.STALL
    gate.at(0.1, BaseReport(v=0.1))
    gate.at(0.2, BaseLost())
    gate.at(0.3, BaseReport(stalled=(True, True)))
    assert gate.enable(0.3).refusal is Reason.STALL


def stalled_gate():
    gate = in_contact(BaseReport(stalled=(True, True)))
    assert gate.keep(9.2, 0.7, AWAY).velocity == (-0.1, 0.0)
    return gate


def test_stall_keeps_its_side_while_it_lasts():
    gate = stalled_gate()
    assert gate.drive(9.95, Velocity(0.1, 0.0)).held is Reason.STALL


def test_stall_must_end_within_exactly_this_time():
    gate = stalled_gate()
    granted_s = gate.state.lease.granted_s
    assert gate.at(granted_s + 1.0, gate.report).held is None
    verdict = gate.at(math.nextafter(granted_s + 1.0, math.inf), gate.report)
    assert (verdict.velocity, verdict.held, gate.state.lease_over) == (ZERO, Reason.STALL, Reason.STALL)


def test_renewals_give_a_stall_no_more_time():
    gate = stalled_gate()
    for k in range(4):
        assert gate.renew(9.95 + 0.05 * k).refusal is None
    assert gate.at(10.15, gate.report).held is Reason.STALL
    assert gate.state.lease_over is Reason.STALL


def test_stall_that_ends_and_begins_again_ends_the_lease():
    gate = stalled_gate()
    gate.report = BaseReport(v=-0.1)
    assert gate.drive(9.92, AWAY).held is None
    assert gate.at(9.95, BaseReport(stalled=(True, False))).held is Reason.STALL


def test_bumper_and_stall_of_one_push_leave_the_way_back():
    gate = in_contact(BaseReport(bumpers=(2, 0), stalled=(True, True)))
    assert gate.drive(9.2, Velocity(0.1, 0.0)).held is Reason.BUMPER
    assert gate.keep(9.25, 0.5, AWAY).velocity == (-0.1, 0.0)
    gate.report = FRONT  # the bumper may be pressed for longer than the motors stall
    assert gate.keep(9.8, 0.9, AWAY).velocity == (-0.1, 0.0)


def test_pressed_bumper_may_last():
    gate = in_contact(FRONT)
    assert gate.keep(9.2, 3.0, AWAY).velocity == (-0.1, 0.0)


# Plain ROS


def test_plain_publisher_drives_away_after_a_zero_command_alone():
    gate = Gate(accept_ros=True)
    gate.at(0.0, FRONT)
    for k in range(40):
        gate.at(0.1 * k, FRONT)
        assert gate.at(0.1 * k, VelocityCommand(AWAY)).dropped is Reason.BUMPER
    assert gate.at(4.0, VelocityCommand(ZERO)).dropped is None
    for k in range(1, 5):
        gate.at(4.0 + 0.05 * k, FRONT)
        verdict = gate.at(4.0 + 0.05 * k, VelocityCommand(AWAY))
    assert (verdict.velocity, verdict.held) == ((-0.1, 0.0), None)
    assert gate.at(4.25, VelocityCommand(Velocity(0.1, 0.0))).held is Reason.BUMPER


def test_plain_publisher_gets_no_lease_with_contact_on_both_sides():
    gate = Gate(accept_ros=True)
    gate.at(0.0, BOTH)
    assert gate.at(0.0, VelocityCommand(ZERO)).dropped is Reason.BUMPER
