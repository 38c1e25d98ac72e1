"""A ROS 2 robot's battery, and its messages that are passed on. Pure."""

import math

from bridge.base import PassedOn
from rover_ncp.core.errors import FormatError
from rover_ncp.wire.key_table import spec
from rover_ncp.wire.messages import (
    BatterySample,
    boolean,
    read_battery,
    read_docked,
    read_pose,
    with_covariance,
)

BATTERY_S = 60.0
"""A battery's state is that of the robot for so long. Some robots report it every 10 s."""
_NO_BATTERY = BatterySample(0, 0.0, None)


class RosBattery:
    """The newest state of a battery."""

    def __init__(self) -> None:
        self._newest, self._at_s = _NO_BATTERY, -math.inf

    def take(self, payload: bytes, now: float) -> None:
        """Take a BatteryState. Raises FormatError, also for a voltage that is not finite."""
        battery = read_battery(payload)
        if not math.isfinite(battery.voltage):
            raise FormatError(f"its voltage is {battery.voltage:g}")
        self._newest, self._at_s = battery, now

    def state(self, now: float) -> tuple[BatterySample, float]:
        """Return the state and its age in s; nothing is known of one that is too old."""
        age_s = now - self._at_s
        return (self._newest, age_s) if age_s <= BATTERY_S else (_NO_BATTERY, 0.0)


def docked_passed_on(payload: bytes, field: str) -> PassedOn:
    """Return whether the robot says that it is docked, for drivers. Raises FormatError."""
    return PassedOn("docked", boolean(read_docked(payload, field)))


def pose_passed_on(payload: bytes) -> PassedOn:
    """Return a pose for drivers, which decide on its frame and its use. Raises FormatError."""
    data, limit = with_covariance(payload), spec("pose").max_bytes
    read_pose(data)
    if len(data) > limit:
        raise FormatError(f"it has {len(data)} bytes, expected {limit} at most")
    return PassedOn("pose", data)
