"""A robot's Imu messages as mean turn rates between its odometry messages. Pure.

The two arrive in any order, and a gyro may be faster or slower than odometry. So each message counts for the
time that it covers by its stamps, not for the time between two odometry messages.
"""

import math

from bridge.base import TurnRate
from rover_ncp.core.clock_offset import StampClock
from rover_ncp.core.errors import FormatError
from rover_ncp.wire.messages import GYRO_GAP_S, read_imu


class GyroTurns:
    """Takes Imu messages; each has the mean turn rate since the one before."""

    def __init__(self) -> None:
        self._clock = StampClock()
        self._at_s = -math.inf
        """When the newest message was measured, on the bridge's clock."""
        self._rad = self._seconds = self._rate = 0.0
        self._new = False

    def take(self, payload: bytes, arrived_s: float) -> None:
        """Take a message. Raises FormatError for one that is not finite, not new, or of a doubtful stamp."""
        sample = read_imu(payload)
        at_s: float | None = arrived_s
        if sample.stamp_ns != 0:  # else a publisher without a clock
            measured_ns = self._clock.measured_ns(sample.stamp_ns, round(arrived_s * 1e9))
            at_s = None if measured_ns is None else measured_ns * 1e-9
        if not math.isfinite(sample.rate):
            raise FormatError(f"its rate of turn is {sample.rate:g}")
        if at_s is None or at_s <= self._at_s:
            raise FormatError("its stamp jumps, or is not newer than that of the message before")
        seconds = at_s - self._at_s
        if seconds > GYRO_GAP_S:
            self._rad = self._seconds = 0.0
        else:
            self._rad += sample.rate * seconds
            self._seconds += seconds
        self._at_s, self._rate, self._new = at_s, sample.rate, True

    def since_last(self, now: float) -> TurnRate | None:
        """Return the mean rate since the last call; None if no message came."""
        if not self._new:
            return None
        rate = self._rad / self._seconds if self._seconds > 0.0 else self._rate
        self._rad, self._seconds, self._new = 0.0, 0.0, False
        return TurnRate(rate, max(now - self._at_s, 0.0))
