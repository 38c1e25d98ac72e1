"""Faults of the mock: how they are written, when they begin, what a client sees of them."""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from kit.pioneer_bench import Pioneer

from bridge.pioneer.framing import Command, Decoder, Packet, encode_frame
from bridge.pioneer.packets import Flag
from rover_ncp.core.errors import UsageError
from sim.base.client_commands import MockCommand
from sim.base.faults import FAULTS, Fault, Faults, parse_fault
from sim.base.firmware import ClientState


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("mute", Fault("mute")),
        ("mute@12.0", Fault("mute", 0.0, 12.0)),
        ("mute@12-14.5", Fault("mute", 0.0, 12.0, 14.5)),
        ("corrupt", Fault("corrupt", 0.1)),
        ("corrupt=0.25@3", Fault("corrupt", 0.25, 3.0)),
        ("low-battery=10.8@8", Fault("low-battery", 10.8, 8.0)),
    ],
)
def test_fault_texts_are_parsed(text: str, fault: Fault) -> None:
    assert parse_fault(text) == fault


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("explode", "NAME one of mute, deaf"),
        ("mute=1", "takes no value"),
        ("mute@soon", "expected numbers"),
        ("corrupt=most", "expected numbers"),
        ("corrupt=1.5", "value from 0 to 1"),
        ("corrupt=nan", "value from 0 to 1"),
        ("low-battery=-3", "value from 0 to 25"),
        ("mute@5-4", "end after the start"),
        ("mute@nan", "end after the start"),
        ("", "NAME one of"),
    ],
)
def test_invalid_fault_is_rejected(text: str, expected: str) -> None:
    with pytest.raises(UsageError, match=expected):
        parse_fault(text)


@given(
    st.text(max_size=20) | st.builds("{}={}@{}-{}".format, st.sampled_from(list(FAULTS)), *[st.text()] * 3)
)
def test_any_text_is_a_fault_or_a_usage_error(text: str) -> None:
    try:
        fault = parse_fault(text)
    except UsageError:
        return
    assert fault.name in FAULTS


def test_times_count_from_the_first_enable() -> None:
    pioneer = Pioneer("p3at-sh", "bumper@1-2").open(motors=False)
    pioneer.run(5.0)
    pioneer.tell(Command.ENABLE, 1)
    for seconds, bumpers in ((0.9, 0), (0.5, 0b1000), (0.7, 0)):
        pioneer.run(seconds)
        assert pioneer.sips()[-1].stall_right == bumpers


def driven(*faults: str) -> Pioneer:
    """Drive for 4 s; the fault is there from the second second on."""
    pioneer = Pioneer("p3at-sh", *faults).open()
    pioneer.drive(200, 4.0)
    return pioneer


def test_mute_base_sends_nothing_and_keeps_driving() -> None:
    pioneer = driven("mute@2")
    assert len(pioneer.sips()) == pytest.approx(20, abs=1)
    assert pioneer.speed == pytest.approx(0.2)


def test_deaf_starves_the_watchdog() -> None:
    pioneer = driven("deaf@1")
    pioneer.run(1.0)
    assert pioneer.speed == 0.0
    assert len(pioneer.sips()) == 50


@pytest.mark.parametrize(
    ("fault", "jump", "after"), [("freeze-odometry@2", 20, 0), ("jump-odometry=0.5@2", 520, 20)]
)
def test_odometry_stands_or_jumps_while_the_rover_drives(fault: str, jump: int, after: int) -> None:
    pioneer = driven(fault)
    steps = [b.x - a.x for a, b in zip(pioneer.sips(), pioneer.sips()[1:], strict=False)]
    assert max(steps) == pytest.approx(jump, abs=2)
    assert steps[25:] == pytest.approx([after] * len(steps[25:]), abs=1)
    assert pioneer.rover.pose.x > 0.5


def test_stall_blocks_the_wheels() -> None:
    pioneer = driven("stall@2")
    assert pioneer.speed == 0.0
    assert pioneer.sips()[-1].stall_left == pioneer.sips()[-1].stall_right == 1


def test_stop_button_switches_the_motors_off_until_enabled() -> None:
    pioneer = driven("stop-button@2-3")
    pressed = [sip for sip in pioneer.sips() if sip.flags & Flag.STOP_BUTTON]
    assert len(pressed) == pytest.approx(10, abs=1)
    assert not any(sip.flags & Flag.MOTORS for sip in [*pressed, pioneer.sips()[-1]])
    assert pioneer.speed == 0.0
    pioneer.tell(Command.ENABLE, 1)
    assert pioneer.sip().flags & Flag.MOTORS


def test_enable_has_no_effect_while_the_stop_button_is_pressed() -> None:
    pioneer = driven("stop-button@2")
    pioneer.tell(Command.ENABLE, 1)
    assert not pioneer.sip().flags & Flag.MOTORS
    free = Pioneer("p3at-sh", "stop-button@1").open()
    free.obey(2.0, MockCommand.E_STALL, 0)
    shown = free.sip().flags & (Flag.MOTORS | Flag.STOP_BUTTON | Flag.E_STALL)
    assert shown == Flag.MOTORS | Flag.STOP_BUTTON


def test_a_low_battery_shows_in_every_field() -> None:
    sip = driven("low-battery=10.5@2").sips()[-1]
    assert (sip.battery_dv, sip.battery_x10) == (105, 105)
    assert sip.faults == 1 << 3


def test_a_reset_gives_notice_once_and_waits_for_a_client() -> None:
    pioneer = driven("reset@2-2.1")
    assert len(pioneer.of_kind(0xFF)) == 1
    assert pioneer.firmware.client is ClientState.WAITING
    pioneer.run(2.0)
    assert pioneer.speed == 0.0
    pioneer.open()
    pioneer.firmware.inject(parse_fault("reset@1-1.1"))
    pioneer.run(0.9)
    assert pioneer.firmware.client is ClientState.OPEN
    pioneer.run(1.0)
    assert len(pioneer.of_kind(0xFF)) == 2


@pytest.mark.parametrize("name", ["corrupt", "drop", "noise"])
def test_damage_hits_its_share_of_packets_the_same_ones_for_a_seed(name: str) -> None:
    frame = encode_frame(0x32, bytes(range(40)))

    def line(seed: int) -> list[bytes]:
        faults = Faults([parse_fault(f"{name}=0.3")], seed)
        return [faults.damage(frame, None) for _ in range(1000)]

    damaged = [data for data in line(1) if data != frame]
    assert len(damaged) == pytest.approx(300, abs=60)
    assert line(1) == line(1) != line(2)
    whole = Packet(0x32, bytes(range(40)))
    if name != "noise":
        assert not any(whole in Decoder().feed(data) for data in damaged)


def test_injected_fault_counts_from_its_injection() -> None:
    pioneer = Pioneer("p3at-sh").open()
    for _ in range(2):
        pioneer.firmware.inject(parse_fault("bumper@1-2"))
        for pressed in (False, True, False):
            pioneer.run(0.8)
            assert bool(pioneer.sips()[-1].stall_right) is pressed
