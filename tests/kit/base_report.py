"""A report of the base, and the time at which the bridge received it."""

from bridge.base import BaseReport

STAMP = 1_700_000_000_123_456_789
STATE = BaseReport(
    x=1.0,
    y=-2.0,
    theta=7.0,  # more than a turn: the base counts on
    v=0.16,
    omega=-0.18,
    motors_on=True,
    stop_pressed=False,
    stalled=(False, False),
    bumpers=(0b10, 0b1),
    battery_v=12.5,
)
