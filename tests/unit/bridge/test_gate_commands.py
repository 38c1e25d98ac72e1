"""The gate: which commands it accepts. Stale, replayed, foreign, malformed, plain ROS."""

import math
from dataclasses import replace

import pytest
from gate_bench import LIMITS, SECRET, SLOW, Gate

from bridge.base import BaseReport
from bridge.gate.state import (
    ZERO,
    BaseLost,
    Enable,
    Reason,
    ReleaseStop,
    Stop,
    Tick,
    VelocityCommand,
    read_tag,
)
from rover_ncp.core.geometry import Velocity
from rover_ncp.wire.protocol import CommandTag, Signed

INVALID = [
    (None, Reason.UNREADABLE),
    (Velocity(math.nan, 0.0), Reason.NOT_FINITE),
    (Velocity(0.1, math.inf), Reason.NOT_FINITE),
    (Velocity(-math.inf, 0.0), Reason.NOT_FINITE),
]

# Lateness


def test_silence_stops_and_a_later_command_drives_on():
    gate = Gate().driving()
    gate.at(0.25, BaseReport())
    assert gate.at(0.29, Tick()).velocity == SLOW
    verdict = gate.at(0.31, Tick())
    assert (verdict.velocity, verdict.held) == (ZERO, Reason.SILENCE)
    assert gate.state.stops == {Reason.SILENCE: 1}
    gate.at(0.55, BaseReport())
    assert gate.drive(0.6).velocity != ZERO


def test_delayed_command_is_in_force_for_less_time():
    gate = Gate().driving()
    gate.drive(0.2, age=0.15)
    gate.at(0.3, BaseReport())
    assert gate.at(0.34, Tick()).velocity != ZERO
    assert gate.at(0.36, Tick()).held is Reason.SILENCE


def test_the_lease_lapses_without_commands():
    gate = Gate().driving()
    for k in range(1, 10):
        gate.at(0.1 * k, BaseReport())
    assert gate.state.lease is not None
    assert gate.at(1.01, BaseReport()).held is Reason.NO_LEASE
    assert gate.state.lease_over is Reason.LEASE_LAPSED
    assert gate.enable(1.05).refusal is None


def test_stale_odometry_holds_the_rover_until_reports_return():
    gate = Gate().driving()
    for k in range(1, 7):
        verdict = gate.drive(0.05 * k)
    assert verdict.velocity == SLOW
    assert gate.drive(0.36).held is Reason.ODOMETRY
    gate.at(0.4, BaseReport())
    assert gate.drive(0.42).velocity != ZERO


@pytest.mark.parametrize("field", ["x", "y", "theta", "v", "omega"])
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_odometry_that_is_not_finite_holds_the_rover(field, value):
    gate = Gate().driving()
    verdict = gate.at(0.05, BaseReport(**{field: value}))
    assert (verdict.velocity, verdict.held) == (ZERO, Reason.ODOMETRY)


def test_a_link_that_stalls_delivers_nothing_but_stale_commands():
    gate = Gate().driving()
    sent = [(0.1 * k, gate.sequence + k) for k in range(1, 50)]
    for moment, sequence in sent:  # all of them arrive at 5 s
        gate.at(5.0, BaseReport())
        verdict = gate.drive(5.0, age=5.0 - moment, sequence=sequence)
        assert verdict.velocity == ZERO
        assert verdict.dropped in {Reason.NO_LEASE, Reason.STALE}


def test_commands_older_than_the_lease_are_stale():
    gate = Gate()
    gate.at(0.0, BaseReport())
    gate.enable(0.0)
    stamp = gate.stamp(0.0) - 1
    assert gate.at(0.0, VelocityCommand(SLOW, CommandTag(1, 1, stamp), signed=True)).dropped is Reason.STALE


def test_delay_from_the_first_command_on_is_detected():
    gate = Gate()
    gate.at(9.9, BaseReport())
    gate.enable(9.9)
    gate.at(10.2, BaseReport())
    assert gate.drive(10.2, age=0.19).dropped is None
    assert gate.drive(10.25, age=0.21).dropped is Reason.STALE


def test_new_lease_resets_the_clock_offset():
    gate = Gate().driving()
    gate.ahead_s += 3600.0
    assert gate.drive(0.1).dropped is None  # it seems quicker than any before it
    gate.ahead_s -= 3600.0
    assert gate.drive(0.2).dropped is Reason.STALE
    gate.release(0.25)
    gate.at(0.3, BaseReport())
    assert gate.enable(0.3).refusal is None
    assert gate.drive(0.4).dropped is None


def test_renewal_over_a_link_that_became_slow_makes_no_stale_command_fresh():
    gate = Gate().driving()
    gate.at(0.3, BaseReport())
    gate.ahead_s -= 0.4  # all that arrives was sent 0.4 s earlier
    assert gate.renew(0.3).refusal is None
    assert gate.drive(0.4).dropped is Reason.STALE


def test_renewal_that_arrives_sooner_than_the_request_counts():
    gate = Gate()
    gate.ahead_s -= 0.4
    gate.at(0.0, BaseReport())
    gate.enable(0.0)
    gate.ahead_s += 0.4
    gate.at(0.1, BaseReport())
    assert gate.renew(0.1).refusal is None
    assert gate.drive(0.2).dropped is None
    gate.ahead_s -= 0.4
    assert gate.drive(0.3).dropped is Reason.STALE


def test_words_for_the_end_of_a_lease_last_until_the_next_lease():
    gate = Gate().driving()
    gate.at(0.1, BaseLost("the line is broken"))
    assert gate.state.lease_over is Reason.NO_BASE
    assert gate.state.lease_over_detail == "the base is not connected: the line is broken"
    gate.at(0.2, BaseReport())
    assert gate.enable(0.2).refusal is None
    assert gate.state.lease_over_detail == ""
    gate.release(0.3)
    assert gate.state.lease_over_detail == ""


def test_smallest_delay_may_come_at_any_time():
    gate = Gate().driving()
    for k in range(1, 120):
        gate.at(0.25 * k, BaseReport())
        assert gate.drive(0.25 * k, age=-0.1 if k == 40 else 0.09).dropped is None
    assert gate.drive(30.0, age=0.15).dropped is Reason.STALE


@pytest.mark.parametrize("drift", [1e-4, -1e-4])
def test_clocks_that_drift_apart_for_three_hours_do_not_matter(drift):
    gate = Gate().driving()
    for k in range(1, 3 * 3600 * 2):
        now = 0.5 * k
        gate.ahead_s = 1234.5 + drift * now
        gate.at(now, BaseReport())
        assert gate.drive(now).held is None
    assert len(gate.state.minima) <= 62
    assert gate.drive(now + 0.25, age=0.21).dropped is Reason.STALE


# Whose command


def test_unsigned_commands_are_dropped():
    gate = Gate().driving()
    assert gate.drive(0.01, Velocity(-0.3, 0.6), signed=False).velocity == SLOW
    assert gate.at(0.02, VelocityCommand(Velocity(-0.3, 0.6))).velocity == SLOW
    assert gate.state.dropped == {Reason.FOREIGN: 2}


@pytest.mark.parametrize("sequence", [3, 2, 0])
def test_repeated_and_overtaken_commands_are_dropped(sequence):
    gate = Gate().driving()
    verdict = gate.drive(0.01, Velocity(-0.3, 0.6), sequence=sequence)
    assert (verdict.velocity, verdict.dropped) == (SLOW, Reason.REPEATED)


def test_renewal_does_not_accept_old_sequence_numbers():
    gate = Gate().driving()
    assert gate.renew(0.1).refusal is None
    assert gate.drive(0.11, sequence=3).dropped is Reason.REPEATED


def test_a_request_without_the_key_is_refused_while_a_lease_is_held():
    gate = Gate().driving()
    before = gate.state
    verdict = gate.enable(0.1, secret=bytes(32))
    assert (verdict.refusal, verdict.velocity) == (Reason.ANOTHER_DRIVER, SLOW)
    assert gate.state.lease == before.lease
    assert gate.state.target_until_s == before.target_until_s
    assert gate.drive(0.15).dropped is None
    assert gate.release(0.2).lease is None
    assert gate.state.lease_over is None
    assert gate.enable(0.25).refusal is None


def test_a_renewal_keeps_number_and_key_and_lengthens_the_lease():
    gate = Gate().driving()
    gate.at(0.9, BaseReport())
    verdict = gate.renew(0.9, secret=bytes(32))
    assert verdict.refusal is None
    assert (verdict.lease.number, verdict.lease.secret) == (1, SECRET)
    gate.at(1.85, BaseReport())
    assert gate.drive(1.85).dropped is None


def test_a_new_lease_has_a_new_number_and_the_new_key():
    gate = Gate().driving()
    gate.release(0.1)
    verdict = gate.enable(0.2, secret=bytes(32))
    assert (verdict.lease.number, verdict.lease.secret) == (2, bytes(32))


def test_a_renewal_that_comes_after_its_lease_is_a_first_request():
    gate = Gate().driving()
    gate.at(1.2, BaseReport())
    verdict = gate.renew(1.2, sequence=0, secret=bytes(32))
    assert (verdict.refusal, verdict.lease.number, verdict.lease.secret) == (None, 2, bytes(32))
    assert gate.drive(1.25, sequence=0).dropped is None


@pytest.mark.parametrize("sequence", [3, 2, 0])
def test_a_renewal_counts_once(sequence):
    gate = Gate().driving()
    verdict = gate.renew(0.1, sequence)
    assert (verdict.refusal, verdict.velocity) == (Reason.REPEATED, SLOW)
    assert gate.renew(0.1, 4).refusal is None
    assert gate.renew(0.1, 4).refusal is Reason.REPEATED
    assert gate.drive(0.1, sequence=4).dropped is Reason.REPEATED


@pytest.mark.parametrize("sequence", [3, 2, 0])
def test_a_release_that_was_repeated_releases_nothing(sequence):
    gate = Gate().driving()
    assert gate.release(0.1, sequence).velocity == SLOW
    assert gate.state.lease is not None
    assert gate.release(0.1, 4).velocity == ZERO
    assert gate.state.lease is None
    assert gate.release(0.1, 5).held is Reason.NO_LEASE


def test_the_key_is_in_no_text_about_the_gate():
    gate = Gate().driving()
    for words in (repr(gate.state), repr(gate.at(0.1, BaseReport())), repr(Enable("x", 0, SECRET))):
        assert repr(SECRET) not in words


@pytest.mark.parametrize(("velocity", "reason"), INVALID)
def test_invalid_command_of_the_driver_holds_the_rover_until_a_valid_one(velocity, reason):
    gate = Gate().driving()
    verdict = gate.drive(0.1, velocity)
    assert (verdict.velocity, verdict.held, verdict.dropped) == (ZERO, reason, reason)
    assert gate.drive(0.2).velocity != ZERO


def test_invalid_commands_of_others_change_nothing():
    gate = Gate().driving()
    assert gate.drive(0.1, None, signed=False).velocity == SLOW
    assert gate.at(0.1, VelocityCommand(None)).velocity == SLOW


def test_signature_is_valid_for_its_lease_key_kind_and_bytes_only():
    lease = Gate().driving().state.lease
    tag = CommandTag(1, 9, 0).sign(SECRET, Signed.COMMAND, "cmd_vel", b"x")
    assert lease.signed(read_tag(tag.pack()), Signed.COMMAND, "cmd_vel", b"x")
    assert not lease.signed(tag, Signed.MOTORS, "cmd_vel", b"x")
    assert not lease.signed(tag, Signed.COMMAND, "bot1/cmd_vel", b"x")
    assert not lease.signed(tag, Signed.COMMAND, "cmd_vel", b"y")
    assert not replace(lease, number=2).signed(tag, Signed.COMMAND, "cmd_vel", b"x")
    assert not replace(lease, secret=bytes(32)).signed(tag, Signed.COMMAND, "cmd_vel", b"x")
    assert not replace(lease, secret=None).signed(tag, Signed.COMMAND, "cmd_vel", b"x")
    for attachment in (None, b"", b"x" * 39):
        assert not lease.signed(read_tag(attachment), Signed.COMMAND, "cmd_vel", b"x")
    assert read_tag(b"x" * 39) is not None  # with an attachment it is no plain ROS command


# Plain ROS commands

CLEAR = BaseReport()


def test_plain_commands_drive_where_they_are_accepted():
    gate = Gate(accept_ros=True)
    gate.at(0.0, BaseReport(motors_on=False))
    verdict = gate.at(0.1, VelocityCommand(SLOW))
    assert (verdict.dropped, verdict.motors) == (None, True)
    assert (gate.state.lease.name, gate.state.lease.secret) == ("ros", None)
    gate.at(0.2, BaseReport())
    assert gate.at(0.25, VelocityCommand(SLOW, age_s=0.05)).velocity != ZERO
    assert gate.enable(0.3).refusal is Reason.ANOTHER_DRIVER


@pytest.mark.parametrize(("velocity", "reason"), INVALID)
def test_invalid_plain_command_takes_no_lease(velocity, reason):
    gate = Gate(accept_ros=True)
    gate.at(0.0, BaseReport())
    verdict = gate.at(0.1, VelocityCommand(velocity))
    assert (verdict.dropped, verdict.lease, verdict.motors) == (reason, None, False)
    assert gate.enable(0.2).refusal is None


@pytest.mark.parametrize(("velocity", "reason"), INVALID)
def test_invalid_plain_command_holds_the_rover_until_a_valid_one(velocity, reason):
    gate = Gate(accept_ros=True)
    publish(gate, 0.0, 0.5)
    verdict = gate.at(0.5, VelocityCommand(velocity))
    assert (verdict.velocity, verdict.held, verdict.dropped) == (ZERO, reason, reason)
    assert gate.at(0.6, VelocityCommand(SLOW)).velocity != ZERO


@pytest.mark.parametrize("age_s", [0.31, -0.31, 3600.0, math.nan, math.inf])
def test_plain_commands_with_a_stale_stamp_are_dropped(age_s):
    gate = Gate(accept_ros=True)
    gate.at(0.0, BaseReport())
    assert gate.at(0.1, VelocityCommand(SLOW, age_s=age_s)).dropped is Reason.STALE
    assert gate.state.lease is None


def test_command_is_in_force_for_exactly_the_silence_time():
    gate = Gate(accept_ros=True)
    gate.at(0.0, BaseReport())
    gate.at(0.0, VelocityCommand(SLOW))
    assert gate.at(LIMITS.command_timeout_s, Tick()).held is None
    assert gate.at(math.nextafter(LIMITS.command_timeout_s, 1.0), Tick()).held is Reason.SILENCE


def test_delayed_plain_command_is_in_force_for_less_time():
    gate = Gate(accept_ros=True)
    gate.at(0.0, BaseReport())
    assert gate.at(0.1, VelocityCommand(SLOW, age_s=0.2)).held is None
    assert gate.at(0.21, BaseReport()).held is Reason.SILENCE


def test_plain_lease_is_valid_for_no_signed_driver():
    gate = Gate(accept_ros=True)
    gate.at(0.0, BaseReport())
    gate.at(0.1, VelocityCommand(SLOW))
    assert gate.drive(0.15, signed=False).dropped is Reason.FOREIGN
    assert gate.at(0.2, VelocityCommand(SLOW)).dropped is None


def test_plain_commands_are_dropped_during_a_lease():
    gate = Gate(accept_ros=True).driving()
    verdict = gate.at(0.01, VelocityCommand(Velocity(-0.3, 0.6)))
    assert (verdict.velocity, verdict.dropped) == (SLOW, Reason.FOREIGN)


def test_plain_commands_need_a_zero_after_a_hazard():
    gate = Gate(accept_ros=True)
    gate.at(0.0, BaseReport())
    gate.at(0.0, VelocityCommand(SLOW))
    gate.at(0.1, BaseReport(bumpers=(1, 0)))
    assert gate.at(0.15, VelocityCommand(SLOW)).dropped is Reason.BUMPER
    gate.at(0.2, BaseReport())
    assert gate.at(0.25, VelocityCommand(SLOW)).dropped is Reason.NO_LEASE
    assert gate.at(0.3, VelocityCommand(ZERO)).dropped is None  # the stick is back in the middle
    assert gate.at(0.4, VelocityCommand(SLOW)).velocity != ZERO


def publish(gate, begin, end, event=CLEAR, velocity=SLOW, age_s=None):
    """Publish plain commands at 10 Hz, each after ``event``; return the last verdict."""
    for k in range(round(begin * 10), round(end * 10)):
        gate.at(k / 10, event)
        verdict = gate.at(k / 10, VelocityCommand(velocity, age_s=age_s))
    return verdict


@pytest.mark.parametrize(
    "hazard",
    [
        BaseReport(bumpers=(1, 0)),
        BaseReport(stop_pressed=True),
        BaseReport(stalled=(True, False)),
        Stop("now"),
        BaseLost(),
    ],
)
@pytest.mark.parametrize("released_s", [1.1, 1.3, 4.0])
@pytest.mark.parametrize("begin", [0.0, 1.0])  # before or during the hazard
def test_plain_publisher_without_a_pause_does_not_drive_after_a_hazard(hazard, released_s, begin):
    gate = Gate(accept_ros=True)
    gate.at(0.0, CLEAR)
    if begin < 1.0:
        assert publish(gate, begin, 1.0).velocity == SLOW
    publish(gate, 1.0, released_s, hazard)
    gate.at(released_s, ReleaseStop())
    verdict = publish(gate, released_s, 9.0)
    assert (verdict.velocity, verdict.motors, verdict.dropped) == (ZERO, False, Reason.NO_LEASE)
    gate.at(9.9, CLEAR)
    assert gate.at(9.9, VelocityCommand(SLOW)).dropped is None


def test_plain_publisher_without_a_pause_does_not_drive_after_the_driver_that_freed_the_rover():
    gate = Gate(accept_ros=True)
    publish(gate, 0.0, 1.0)
    publish(gate, 1.0, 1.5, BaseReport(bumpers=(1, 0)))
    publish(gate, 1.5, 2.0)
    assert gate.enable(2.0).refusal is None
    assert publish(gate, 2.0, 2.5).dropped is Reason.FOREIGN
    gate.release(2.5)
    verdict = publish(gate, 2.5, 9.0)
    assert (verdict.velocity, verdict.motors, verdict.dropped) == (ZERO, False, Reason.NO_LEASE)
    gate.at(9.9, CLEAR)
    assert gate.at(9.9, VelocityCommand(SLOW)).dropped is None


def test_plain_publisher_drives_after_a_driver_without_a_hazard():
    gate = Gate(accept_ros=True)
    publish(gate, 0.0, 1.0)
    gate.at(2.1, CLEAR)
    assert gate.enable(2.1).refusal is None
    publish(gate, 2.1, 2.5)
    gate.release(2.5)
    assert publish(gate, 2.5, 4.0).velocity == SLOW


def test_plain_publisher_that_waits_for_the_base_drives_with_its_first_report():
    gate = Gate(accept_ros=True)
    assert publish(gate, 0.0, 1.0, Tick()).dropped is Reason.NO_BASE
    assert publish(gate, 1.0, 1.2).velocity != ZERO


def test_stop_before_the_first_report_needs_a_pause_of_a_plain_publisher():
    gate = Gate(accept_ros=True)
    publish(gate, 0.0, 1.0, Stop("now"))
    gate.at(1.0, ReleaseStop())
    assert publish(gate, 1.0, 5.0).dropped is Reason.NO_LEASE


@pytest.mark.parametrize(("velocity", "age_s"), [(SLOW, 1.0), (None, None), (Velocity(math.nan, 0.0), None)])
def test_plain_command_that_is_invalid_or_stale_is_no_pause_after_a_hazard(velocity, age_s):
    gate = Gate(accept_ros=True)
    gate.at(0.0, BaseReport())
    gate.at(0.0, VelocityCommand(SLOW))
    gate.at(0.0, BaseReport(bumpers=(1, 0)))
    publish(gate, 0.1, 3.0, velocity=velocity, age_s=age_s)
    assert gate.at(3.0, VelocityCommand(SLOW)).dropped is Reason.NO_LEASE


def test_tagged_commands_do_not_delay_plain_ones_after_a_hazard():
    gate = Gate(accept_ros=True).driving()
    gate.at(0.0, BaseReport(bumpers=(1, 0)))
    for k in range(1, 11):
        gate.at(0.1 * k, BaseReport())
        assert gate.drive(0.1 * k).dropped is Reason.NO_LEASE
    assert gate.at(1.0, VelocityCommand(SLOW)).dropped is None


def test_plain_publisher_drives_on_after_a_gap_in_the_network():
    gate = Gate(accept_ros=True)
    gate.at(0.0, BaseReport(bumpers=(1, 0)))
    gate.at(0.0, BaseReport())
    gate.at(0.0, VelocityCommand(ZERO))
    publish(gate, 0.1, 0.5)
    gate.at(1.6, BaseReport())
    assert gate.state.lease_over is Reason.LEASE_LAPSED
    assert publish(gate, 1.7, 2.5).dropped is Reason.NO_LEASE
    assert publish(gate, 2.5, 3.0).velocity == SLOW


def test_plain_commands_get_no_lease_with_stale_odometry():
    gate = Gate(accept_ros=True)
    gate.at(0.0, BaseReport())
    assert gate.at(0.5, VelocityCommand(SLOW)).dropped is Reason.ODOMETRY
