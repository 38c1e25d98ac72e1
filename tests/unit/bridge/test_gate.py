"""The gate: timelines of events and verdicts (tests/data/gate_timelines.txt), and other cases."""

from dataclasses import replace

import pytest
from kit.gate_bench import LIMITS, SECRET, SLOW, Gate, follow, timelines

from bridge.base import BaseReport
from bridge.gate.state import ZERO, BaseLost, Enable, Reason, describe, read_tag
from rover_ncp.core.geometry import Velocity
from rover_ncp.wire.protocol import CommandTag, Signed

FRONT = BaseReport(bumpers=(2, 0))
AWAY = Velocity(-0.2, 0.3)


@pytest.mark.parametrize("timeline", list(timelines()))
def test_timeline(timeline):
    follow(timeline)


def test_delayed_loop_gains_no_acceleration():
    gate = Gate(LIMITS.model_copy(update={"command_timeout_s": 0.4}))
    gate.driving()
    gate.at(0.25, BaseReport())
    gate.state = replace(gate.state, now=0.0, out=ZERO)
    assert gate.drive(0.3, Velocity(0.3, 0.0)).velocity.v == pytest.approx(0.1)


def test_a_link_that_stalls_delivers_nothing_but_stale_commands():
    gate = Gate().driving()
    sent = [(0.1 * k, gate.sequence + k) for k in range(1, 50)]
    for moment, sequence in sent:  # all of them arrive at 5 s
        gate.at(5.0, BaseReport())
        verdict = gate.drive(5.0, age=5.0 - moment, sequence=sequence)
        assert verdict.velocity == ZERO
        assert verdict.dropped in {Reason.NO_LEASE, Reason.STALE}


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


def test_a_request_without_the_key_is_refused_while_a_lease_is_held():
    gate = Gate().driving()
    before = gate.state
    verdict = gate.enable(0.1, secret=bytes(32))
    assert (verdict.refusal, verdict.velocity) == (Reason.ANOTHER_DRIVER, SLOW)
    assert describe(Reason.ANOTHER_DRIVER, gate.state) == "deploy holds the lease"
    assert gate.state.lease == before.lease
    assert gate.state.target_until_s == before.target_until_s
    assert gate.drive(0.15).dropped is None
    assert gate.release(0.2).lease is None
    assert gate.state.lease_over is None
    assert gate.enable(0.25).refusal is None


def test_the_key_is_in_no_text_about_the_gate():
    gate = Gate().driving()
    for words in (repr(gate.state), repr(gate.at(0.1, BaseReport())), repr(Enable("x", 0, SECRET))):
        assert repr(SECRET) not in words


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


def test_renewal_permits_no_new_contact():
    gate = Gate().driving(9.0)
    gate.state = gate.state.__class__(**{**vars(gate.state), "base": FRONT})
    gate.sequence += 1
    stamp = gate.stamp(9.0)
    assert gate.at(9.0, Enable("deploy", stamp, bytes(32), gate.sequence)).refusal is Reason.BUMPER
    assert gate.state.lease is None


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


@pytest.mark.parametrize("steps", [{"x": 0.001}, {"y": 0.001}, {"theta": 0.0015}])
def test_one_changed_count_is_no_frozen_odometry(steps):
    gate = Gate().driving()
    for k in range(1, 40):
        pose = {name: (k // 2) * step for name, step in steps.items()}
        gate.at(0.1 * k, BaseReport(v=0.09, omega=0.19, **pose))
        assert gate.drive(0.1 * k).held is None


def test_frozen_distance_uses_the_slower_of_two_reports():
    gate = Gate().driving()
    for k in range(1, 40):
        fast = 0.3 * (k % 2)
        gate.at(0.1 * k, BaseReport(v=fast, omega=fast))
        assert gate.drive(0.1 * k).held is None


@pytest.mark.parametrize("name", ["v", "omega"])
def test_speed_that_changes_its_sign_is_no_frozen_odometry(name):
    # Motors that hold a robot on a slope flicker by a tick of its encoders.
    gate = Gate()
    for k in range(100):
        gate.at(0.1 * k, BaseReport(x=1.0, **{name: 0.014 if k % 4 < 2 else -0.014}))
    assert gate.enable(10.0).refusal is None


def test_one_minimum_is_kept_for_each_second():
    gate = Gate().driving()
    for k in range(100):
        gate.at(0.05 * k, BaseReport())
        gate.drive(0.05 * k)
    assert len(gate.state.minima) <= 6
