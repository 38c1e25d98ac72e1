"""A LaserScan as the room before and behind a robot, in place of sonars. Pure."""

import math

import numpy as np

from rover_ncp.core.cdr import decode
from rover_ncp.core.errors import FormatError
from rover_ncp.core.messages import LASER_SCAN
from rover_ncp.core.robot_description import RobotDescription

VALID_S = 1.0
"""How long a scan counts, as a sonar's range does."""
MARGIN_M = 0.05
"""The way that must be clear is wider than the robot by this on each side."""
BEAMS_APART = 1.5
"""A direction was scanned if a beam lies within this many steps of it."""


class ScanRoom:
    """The newest scan of a robot that has one."""

    def __init__(self, description: RobotDescription) -> None:
        assert description.scan is not None
        self._robot, self._mount = description, description.scan
        self._at_s, self._room = -math.inf, (math.nan, math.nan)

    def take(self, payload: bytes, now: float) -> None:
        """Take a LaserScan. Raises FormatError."""
        message = decode(LASER_SCAN, payload)
        ranges = np.asarray(message.ranges, np.float64)
        step = float(message.angle_increment)
        limits = (float(message.angle_min), step, float(message.range_min), float(message.range_max))
        if not len(ranges) or not all(map(math.isfinite, limits)) or step == 0.0:
            raise FormatError("a scan without beams or without finite angles")
        angles = message.angle_min + step * np.arange(len(ranges)) + math.radians(self._mount.yaw_deg)
        seen = np.isfinite(ranges) & (ranges >= message.range_min) & (ranges <= message.range_max)
        x = self._mount.x_m + ranges[seen] * np.cos(angles[seen])
        y = self._mount.y_m + ranges[seen] * np.sin(angles[seen])
        front, rear, half = self._robot.front_m, self._robot.rear_m, self._robot.width_m / 2
        # Posts of the robot's own are within its outline.
        other = (np.abs(y) <= half + MARGIN_M) & ~((x >= -rear) & (x <= front) & (np.abs(y) <= half))
        ahead = _least(x[other & (x > 0.0)] - front) if _scanned(angles, 0.0, step) else math.nan
        behind = _least(-x[other & (x < 0.0)] - rear) if _scanned(angles, math.pi, step) else math.nan
        self._at_s, self._room = now, (ahead, behind)

    def clear(self, now: float) -> tuple[float, float]:
        """Return the room in m from the outline to the nearest thing ahead and behind; NaN = not known."""
        return self._room if now - self._at_s <= VALID_S else (math.nan, math.nan)


def _least(room: "np.ndarray[tuple[int], np.dtype[np.float64]]") -> float:
    return max(float(room.min()), 0.0) if len(room) else math.inf


def _scanned(angles: "np.ndarray[tuple[int], np.dtype[np.float64]]", direction: float, step: float) -> bool:
    apart = np.abs(np.remainder(angles - direction + math.pi, math.tau) - math.pi)
    return bool(apart.min() <= BEAMS_APART * abs(step))
