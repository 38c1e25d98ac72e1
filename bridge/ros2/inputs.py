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
    """The newest state of a battery. Messages with one stamp are one report, as old as the first of them."""

    def __init__(self) -> None:
        self._newest, self._at_s, self._reported_s = _NO_BATTERY, -math.inf, -math.inf

    def take(self, payload: bytes, now: float) -> None:
        """Take a BatteryState. Raises FormatError, also for a voltage that is not finite."""
        battery = read_battery(payload)
        if not math.isfinite(battery.voltage):
            raise FormatError(f"its voltage is {battery.voltage:g}")
        if not battery.stamp_ns or battery.stamp_ns != self._newest.stamp_ns:
            self._reported_s = now
        self._newest, self._at_s = battery, now

    def state(self, now: float) -> tuple[BatterySample, float]:
        """Return the state and the report's age in s; nothing is known without a message for `BATTERY_S`."""
        if now - self._at_s > BATTERY_S:
            return _NO_BATTERY, 0.0
        return self._newest, now - self._reported_s


class DockedReports:
    """Reports of a robot on whether it is docked, by a field of its topic's messages."""

    def __init__(self, field: str) -> None:
        self._field, self._stamp_ns = field, 0

    def take(self, payload: bytes) -> list[PassedOn]:
        """Return a new report for drivers, none for one that is repeated. Raises FormatError."""
        docked, stamp_ns = read_docked(payload, self._field)
        repeated, self._stamp_ns = stamp_ns != 0 and stamp_ns == self._stamp_ns, stamp_ns
        return [] if repeated else [PassedOn("docked", boolean(docked))]


def pose_passed_on(payload: bytes) -> PassedOn:
    """Return a pose for drivers, which decide on its frame and its use. Raises FormatError."""
    data, limit = with_covariance(payload), spec("pose").max_bytes
    read_pose(data)
    if len(data) > limit:
        raise FormatError(f"it has {len(data)} bytes, expected {limit} at most")
    return PassedOn("pose", data)
