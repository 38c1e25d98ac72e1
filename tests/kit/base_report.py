"""A report of the base, and the time at which the bridge received it."""

from bridge.pioneer.odometry import BaseState

STAMP = 1_700_000_000_123_456_789
STATE = BaseState(
    received_s=1.0,
    x=1.0,
    y=-2.0,
    theta=7.0,  # more than a turn: the base counts on
    v=0.16,
    omega=-0.18,
    moving=True,
    motors_enabled=True,
    stop_pressed=False,
    stalled=(False, False),
    bumpers=(0b10, 0b1),
    battery_v=12.5,
)
