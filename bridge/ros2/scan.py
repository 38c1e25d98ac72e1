"""A LaserScan as the room before and behind a robot, in place of sonars. Pure."""

import math

import numpy as np
from numpy.typing import NDArray

from rover_ncp.core.clock_offset import StampClock
from rover_ncp.core.errors import FormatError
from rover_ncp.robot.description import Circle, RobotDescription
from rover_ncp.wire.cdr import decode
from rover_ncp.wire.header import read_stamp_ns
from rover_ncp.wire.messages import LASER_SCAN

VALID_S = 1.0
"""How long a scan counts from its stamp on, as a sonar's range does."""
MARGIN_M = 0.05
"""The way that must be clear is wider than the robot by this on each side."""
BEAMS_APART = 1.5
"""A direction was scanned if a beam lies within this many steps of it."""
LOOKS_RAD = math.radians(20.0)
"""The room in a direction is known only if at least one beam within this angle, or those steps, is valid."""


class ScanRoom:
    """The newest scan of a robot that has one."""

    def __init__(self, description: RobotDescription) -> None:
        assert description.scan is not None
        self._robot, self._mount = description, description.scan
        self._clock = StampClock()
        self._at_s, self._room = -math.inf, (math.nan, math.nan)

    def take(self, payload: bytes, now: float) -> None:
        """Take a LaserScan. Raises FormatError."""
        message = decode(LASER_SCAN, payload)
        now_ns = round(now * 1e9)
        stamp_ns = read_stamp_ns(message.header)
        measured_ns = self._clock.measured_ns(stamp_ns, now_ns) if stamp_ns else now_ns
        if measured_ns is None:
            return
        with np.errstate(invalid="ignore"):  # a signalling NaN is one among others
            ranges = np.asarray(message.ranges, np.float64)
        step = float(message.angle_increment)
        limits = (float(message.angle_min), step, float(message.range_min), float(message.range_max))
        if not len(ranges) or not all(map(math.isfinite, limits)) or step == 0.0:
            raise FormatError("a scan without beams or without finite angles")
        angles = message.angle_min + step * np.arange(len(ranges)) + math.radians(self._mount.yaw_deg)
        nothing = np.isposinf(ranges)
        ranges = np.where(np.isneginf(ranges), message.range_min, ranges)  # REP 117: something is too close
        measured = np.isfinite(ranges) & (ranges >= message.range_min) & (ranges <= message.range_max)
        ranges = np.where(measured, ranges, math.nan)
        x = self._mount.x_m + ranges * np.cos(angles)
        y = self._mount.y_m + ranges * np.sin(angles)
        front, rear, half = self._robot.front_m, self._robot.rear_m, self._robot.width_m / 2
        # Posts of the robot's own are within its outline, of which a round one has no corners.
        own = (x >= -rear) & (x <= front) & (np.abs(y) <= half)
        if isinstance(self._robot.footprint, Circle):
            own = np.hypot(x, y) <= half
        other = (np.abs(y) <= half + MARGIN_M) & ~own
        sees = nothing | (measured & ~own)
        ahead = _least(x[other & (x > 0.0)] - front) if _scanned(angles, sees, 0.0, step) else math.nan
        behind = _least(-x[other & (x < 0.0)] - rear) if _scanned(angles, sees, math.pi, step) else math.nan
        self._at_s, self._room = measured_ns * 1e-9, (ahead, behind)

    def clear(self, now: float) -> tuple[float, float]:
        """Return the room in m from the outline to the nearest thing ahead and behind; NaN = not known."""
        return self._room if now - self._at_s <= VALID_S else (math.nan, math.nan)


def _least(room: NDArray[np.float64]) -> float:
    return max(float(room.min()), 0.0) if len(room) else math.inf


def _scanned(angles: NDArray[np.float64], sees: NDArray[np.bool_], direction: float, step: float) -> bool:
    apart = np.abs(np.remainder(angles - direction + math.pi, math.tau) - math.pi)
    near = BEAMS_APART * abs(step)
    return bool(apart.min() <= near and np.any(sees & (apart <= max(near, LOOKS_RAD))))
