"""The gate: which commands count, and whose."""

import math

import pytest
from kit.gate_bench import SECRET, SLOW, Gate, limits, steps

from bridge.gate.state import Reason
from rover_ncp.core.geometry import STANDSTILL, Velocity

OTHER = bytes(32)
AFTER = math.inf


def test_missing_commands_stop_the_rover_and_a_later_one_drives_on():
    gate = Gate().driving()
    gate.report(0.25)
    assert gate.tick(0.29).velocity == SLOW
    verdict = gate.tick(0.31)
    assert (verdict.velocity, verdict.held, gate.state.stops) == (STANDSTILL, Reason.SILENCE, {"silence": 1})
    gate.report(0.55)
    assert gate.drive(0.6).velocity != STANDSTILL


def test_delayed_command_is_in_force_for_less_time():
    gate = Gate().driving()
    gate.drive(0.2, age=0.15)
    gate.report(0.3)
    assert gate.tick(0.34).velocity != STANDSTILL
    assert gate.tick(0.36).held is Reason.SILENCE


def test_command_is_in_force_for_exactly_the_command_timeout():
    gate = Gate(ahead_s=0.0)
    gate.report(0.0)
    gate.enable(0.0)
    gate.drive(0.0)
    assert gate.tick(0.3).held is None
    assert gate.tick(math.nextafter(0.3, AFTER)).held is Reason.SILENCE


def test_lease_expires_after_exactly_a_second_without_commands():
    gate = Gate().driving()
    gate.report(0.9)
    assert gate.tick(1.0).lease.number == 1
    verdict = gate.tick(math.nextafter(1.0, AFTER))
    assert (verdict.lease, verdict.held, gate.state.lease_over) == (None, Reason.NO_LEASE, "lease-lapsed")
    assert gate.enable(1.05).refusal is None


def test_stale_odometry_holds_the_rover_after_exactly_this_time_until_reports_return():
    gate = Gate(limits(command_timeout_s=0.4)).driving()
    assert gate.tick(0.35).held is None
    assert gate.tick(math.nextafter(0.35, AFTER)).held is Reason.ODOMETRY
    gate.report(0.4)
    assert gate.drive(0.42).velocity != STANDSTILL


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("field", ["x", "y", "theta", "v", "omega"])
def test_odometry_that_is_not_finite_holds_the_rover(field, value):
    gate = Gate().driving()
    verdict = gate.report(0.05, **{field: value})
    assert (verdict.velocity, verdict.held) == (STANDSTILL, Reason.ODOMETRY)


def test_command_is_stale_beyond_exactly_this_age():
    gate = Gate(limits(stale_s=0.25), ahead_s=0.0)
    gate.report(0.0)
    gate.enable(0.0)
    assert gate.drive(0.25, age=0.25).dropped is None
    assert gate.drive(0.25, age=0.25, shift_ns=1).dropped is Reason.STALE


def test_new_lease_resets_the_clock_offset():
    gate = Gate().driving()
    gate.ahead_s += 3600.0
    assert gate.drive(0.1).dropped is None
    gate.ahead_s -= 3600.0
    assert gate.drive(0.2).dropped is Reason.STALE
    gate.release(0.25)
    gate.report(0.3)
    assert gate.enable(0.3).refusal is None
    assert gate.drive(0.4).dropped is None


def test_renewal_makes_no_stale_command_fresh_and_its_own_delay_counts():
    gate = Gate().driving()
    gate.report(0.3)
    gate.ahead_s -= 0.4  # a link that became slow
    assert gate.renew(0.3).refusal is None
    assert gate.drive(0.4).dropped is Reason.STALE
    gate = Gate(ahead_s=1000.0)
    gate.report(0.0)
    gate.enable(0.0)
    gate.ahead_s += 0.4  # a renewal that arrives sooner than the request
    gate.report(0.1)
    assert gate.renew(0.1).refusal is None
    assert gate.drive(0.2).dropped is None
    gate.ahead_s -= 0.4
    assert gate.drive(0.3).dropped is Reason.STALE


@pytest.mark.parametrize(("last", "dropped"), [(1060.25, Reason.STALE), (1061.25, None)])
def test_smallest_delay_is_kept_for_a_minute_of_whole_seconds(last, dropped):
    gate = Gate().driving(1000.0)
    for now in steps(1000.25, last, 0.25):
        gate.report(now)
        gate.drive(now, age=0.15)
    gate.report(last + 0.25)
    assert gate.drive(last + 0.25, age=0.3).dropped is dropped


@pytest.mark.parametrize("drift_s", [0.00005, -0.00005])
def test_clocks_that_drift_apart_do_not_matter(drift_s):
    gate = Gate().driving()
    for now in steps(0.5, 600.0, 0.5):
        gate.ahead_s += drift_s
        gate.report(now)
        assert gate.drive(now).held is None
    assert gate.drive(600.25, age=0.21).dropped is Reason.STALE


def test_commands_and_requests_without_the_holders_signature_change_nothing():
    gate = Gate().driving()
    for velocity in (Velocity(-0.3, 0.6), None):
        verdict = gate.drive(0.01, velocity, signed=False)
        assert (verdict.velocity, verdict.dropped) == (SLOW, Reason.FOREIGN)
    assert gate.state.dropped == {Reason.FOREIGN: 2}
    verdict = gate.enable(0.1, OTHER)
    assert (verdict.refusal, verdict.velocity) == (Reason.ANOTHER_DRIVER, SLOW)
    assert verdict.lease.secret == SECRET
    gate.report(0.25)
    gate.enable(0.25, OTHER)
    assert gate.tick(0.31).held is Reason.SILENCE
    assert gate.drive(0.32).dropped is None


@pytest.mark.parametrize("number", [3, 2, 0])
def test_repeated_and_overtaken_messages_do_not_count(number):
    gate = Gate().driving()
    verdict = gate.drive(0.01, Velocity(-0.3, 0.6), sequence=number)
    assert (verdict.velocity, verdict.dropped) == (SLOW, Reason.REPEATED)
    verdict = gate.renew(0.1, sequence=number)
    assert (verdict.velocity, verdict.refusal) == (SLOW, Reason.REPEATED)
    verdict = gate.release(0.1, sequence=number)
    assert (verdict.velocity, verdict.lease.number) == (SLOW, 1)
    assert gate.renew(0.1, sequence=4).refusal is None
    assert gate.renew(0.1, sequence=4).refusal is Reason.REPEATED
    assert gate.drive(0.1, sequence=4).dropped is Reason.REPEATED
    assert gate.release(0.1, sequence=5).lease is None
    assert gate.release(0.1, sequence=6).held is Reason.NO_LEASE


def test_renewal_keeps_number_and_key_and_lengthens_the_lease():
    gate = Gate().driving()
    gate.report(0.9)
    verdict = gate.renew(0.9, secret=OTHER)
    assert (verdict.lease.number, verdict.lease.secret) == (1, SECRET)
    gate.report(1.85)
    assert gate.drive(1.85).dropped is None


def test_new_lease_has_a_new_number_and_the_new_key():
    gate = Gate().driving()
    gate.release(0.1)
    lease = gate.enable(0.2, OTHER).lease
    assert (lease.number, lease.secret) == (2, OTHER)
    gate.report(1.3)  # a renewal that comes after its lease is a first request
    lease = gate.renew(1.3, sequence=0, secret=SECRET).lease
    assert (lease.number, lease.secret) == (3, SECRET)
    assert gate.drive(1.35, sequence=0).dropped is None


@pytest.mark.parametrize(
    ("velocity", "reason"),
    [
        (None, Reason.UNREADABLE),
        (Velocity(math.nan, 0.0), Reason.NOT_FINITE),
        (Velocity(0.1, math.inf), Reason.NOT_FINITE),
        (Velocity(-math.inf, 0.0), Reason.NOT_FINITE),
    ],
)
def test_invalid_command_of_the_driver_holds_the_rover_until_a_valid_one(velocity, reason):
    gate = Gate().driving()
    verdict = gate.drive(0.1, velocity, sequence=50)
    assert (verdict.velocity, verdict.held, verdict.dropped) == (STANDSTILL, reason, reason)
    assert gate.drive(0.1, sequence=50).dropped is Reason.REPEATED
    assert gate.drive(0.2, sequence=51).velocity != STANDSTILL


def test_renewal_clears_command_and_hold_reason():
    gate = Gate().driving()
    verdict = gate.renew(0.1)
    assert (verdict.velocity, verdict.held) == (STANDSTILL, Reason.SILENCE)
    assert gate.drive(0.15, None).held is Reason.UNREADABLE
    assert gate.renew(0.2).held is Reason.SILENCE
