"""The gate: words, limits, signatures, and the memory of delays."""

from dataclasses import replace

import pytest
from kit.gate_bench import SECRET, Gate

from bridge.base import BaseReport
from bridge.gate.limits import Limits
from bridge.gate.state import BaseLost, Enable, GateState, Reason, VelocityCommand, describe, read_tag
from rover_ncp.robot.description import load_description
from rover_ncp.wire.protocol import REASONS, CommandTag, Signed

DRIVING = Gate().driving().state


def test_words_for_the_end_of_a_lease_last_until_the_next_lease():
    gate = Gate().driving()
    gate.at(0.1, BaseLost("the line is broken"))
    assert gate.at(0.15, BaseReport(bumpers=(1, 0))).held is Reason.BUMPER
    assert gate.state.lease_over is Reason.NO_BASE
    assert gate.state.lease_over_detail == "the base is not connected: the line is broken"
    gate.at(0.2, BaseReport())
    assert gate.enable(0.2).refusal is None
    assert gate.state.lease_over_detail == ""
    gate.release(0.3)
    assert gate.state.lease_over_detail == ""


@pytest.mark.parametrize(
    ("reason", "state", "words"),
    [
        (Reason.STOPPED, GateState(stop_reason="Anna"), "Anna"),
        (Reason.STOPPED, GateState(stop_reason=""), "a client that gave no name"),
        (Reason.STOPPED, GateState(), "a stop was requested, and is not released"),
        (Reason.NO_BASE, GateState(lost="x" * 300), ("the base is not connected: " + "x" * 300)[:200]),
        (Reason.NO_BASE, GateState(), "the base is not connected"),
        (Reason.BUMPER, DRIVING._replace(lost="x", stop_reason="Anna"), "a bumper is pressed"),
        (Reason.ANOTHER_DRIVER, GateState(), "another driver holds the lease"),
        (Reason.ANOTHER_DRIVER, DRIVING, "deploy holds the lease"),
        (
            Reason.ANOTHER_DRIVER,
            DRIVING._replace(lease=replace(DRIVING.lease, name="")),
            "a driver without a name holds the lease",
        ),
        (
            Reason.HAZARD_UNKNOWN,
            GateState(base=BaseReport(hazard_unknown="stop: silent")),
            f"{REASONS['hazard-unknown']}: stop: silent",
        ),
        (
            Reason.SONAR,
            GateState(base=BaseReport(room_unknown="y" * 300)),
            f"{REASONS['sonar']}: {'y' * 300}"[:200],
        ),
        (Reason.SONAR, GateState(base=BaseReport(hazard_unknown="stop: silent")), REASONS["sonar"]),
    ],
)
def test_words_of_a_reason_name_who_and_what(reason, state, words):
    assert describe(reason, state) == words


def test_an_unknown_hazard_ends_the_lease_until_it_is_known():
    gate = Gate().driving()
    gate.at(0.1, BaseReport(hazard_unknown="stop: silent"))
    assert gate.state.lease_over is Reason.HAZARD_UNKNOWN
    assert gate.state.lease_over_detail.endswith(": stop: silent")
    assert gate.enable(0.2).refusal is Reason.HAZARD_UNKNOWN
    gate.at(0.3, BaseReport())
    assert gate.enable(0.3).refusal is None


def test_a_robots_own_limits_count_where_they_are_tighter_or_nothing_else_is_set():
    burger = load_description("turtlebot3-burger")
    found = Limits().within(burger)
    assert (found.v_max, found.omega_max, found.brake) == (0.22, 0.6, 0.3)
    assert (found.battery_min_v, found.speed_mean_s) == (burger.battery.min_v, burger.odometry.speed_mean_s)
    assert Limits(v_max=0.1, battery_min_v=12.0).within(burger) == Limits(v_max=0.1, battery_min_v=12.0)
    assert found.within(burger) == found
    husky = load_description("husky-a200")
    means = [Limits(speed_mean_s=mean_s).within(husky).speed_mean_s for mean_s in (0.5, 1.0, 5.0)]
    assert means == [0.5, 1.0, 1.0]  # a longer mean would excuse frozen odometry for longer


def test_the_key_is_in_no_text_about_the_gate():
    gate = Gate().driving()
    for words in (repr(gate.state), repr(gate.at(0.1, BaseReport())), repr(Enable("x", 0, SECRET))):
        assert repr(SECRET) not in words


def test_signature_is_valid_for_its_lease_key_kind_and_bytes_only():
    lease = Gate().driving().state.lease
    tag = CommandTag(1, 9, 0).sign(SECRET, Signed.COMMAND, "cmd_vel", b"x")
    message = (Signed.COMMAND, "cmd_vel", b"x")
    assert lease.signed(read_tag(tag.pack()), *message)
    for other in ((Signed.MOTORS, *message[1:]), (message[0], "bot1/cmd_vel", b"x"), (*message[:2], b"y")):
        assert not lease.signed(tag, *other)
    for change in ({"number": 2}, {"secret": bytes(32)}):
        assert not replace(lease, **change).signed(tag, *message)
    for attachment in (None, b"", b"x" * 39):
        assert not lease.signed(read_tag(attachment), *message)
        assert read_tag(attachment) == CommandTag(0, 0, 0)  # no lease has the number 0


def test_loss_without_a_reason_keeps_the_reason_of_the_one_before():
    gate = Gate().driving()
    gate.at(0.1, BaseLost("the line is broken"))
    gate.at(0.2, BaseLost())
    assert describe(Reason.NO_BASE, gate.state) == "the base is not connected: the line is broken"


@pytest.mark.parametrize("bumpers", [(1, 0), (0, 1)])
def test_a_bumper_is_a_hazard_without_a_lease(bumpers):
    assert Gate().at(0.0, BaseReport(bumpers=bumpers)).held is Reason.BUMPER


def test_command_is_unsigned_and_a_loss_is_no_restart_unless_they_say_so():
    assert not VelocityCommand(None, CommandTag(1, 1, 1)).signed
    assert not BaseLost().restarted


def test_renewal_permits_no_new_contact():
    gate = Gate().driving(9.0)
    gate.state = gate.state._replace(base=BaseReport(bumpers=(2, 0)))
    assert gate.renew(9.0, secret=bytes(32)).refusal is Reason.BUMPER
    assert gate.state.lease is None
