"""Faults of the mock: how they are written, when they begin, what a client sees of them."""

import pytest
from kit.pioneer_bench import Pioneer

from bridge.pioneer.framing import Command
from bridge.pioneer.packets import Flag
from rover_ncp.core.errors import UsageError
from sim.base.client_commands import MockCommand
from sim.base.faults import parse_fault


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("explode", "NAME one of mute, deaf"),
        ("mute@soon", "expected numbers"),
        ("corrupt=nan", "value from 0 to 1"),
    ],
)
def test_invalid_fault_is_rejected(text: str, expected: str) -> None:
    with pytest.raises(UsageError, match=expected):
        parse_fault(text)


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


@pytest.mark.parametrize(
    ("fault", "jump", "after"), [("freeze-odometry@2", 20, 0), ("jump-odometry=0.5@2", 520, 20)]
)
def test_odometry_stands_or_jumps_while_the_rover_drives(fault: str, jump: int, after: int) -> None:
    pioneer = driven(fault)
    steps = [b.x - a.x for a, b in zip(pioneer.sips(), pioneer.sips()[1:], strict=False)]
    assert max(steps) == pytest.approx(jump, abs=2)
    assert steps[25:] == pytest.approx([after] * len(steps[25:]), abs=1)
    assert pioneer.rover.pose.x > 0.5


def test_enable_has_no_effect_while_the_stop_button_is_pressed() -> None:
    pioneer = driven("stop-button@2")
    pioneer.tell(Command.ENABLE, 1)
    assert not pioneer.sip().flags & Flag.MOTORS
    free = Pioneer("p3at-sh", "stop-button@1").open()
    free.obey(2.0, MockCommand.E_STALL, 0)
    shown = free.sip().flags & (Flag.MOTORS | Flag.STOP_BUTTON | Flag.E_STALL)
    assert shown == Flag.MOTORS | Flag.STOP_BUTTON
