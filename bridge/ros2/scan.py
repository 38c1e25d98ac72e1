"""A LaserScan as the room before and behind a robot, in place of sonars. Pure."""

import math
from collections import deque
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rover_ncp.core.clock_offset import StampClock
from rover_ncp.core.errors import FormatError
from rover_ncp.robot.description import Circle, RobotDescription
from rover_ncp.wire.cdr import decode
from rover_ncp.wire.message_parts import read_stamp_ns
from rover_ncp.wire.messages import LASER_SCAN

VALID_S = 1.0
"""How long a scan counts from its stamp on, as a sonar's range does."""
ROUND_S = 0.3
"""The nearest thing in scans of so long counts, as in a round of sonars: two lasers may share a topic."""
MARGIN_M = 0.05
"""The way that must be clear is wider than the robot by this on each side."""
MAX_SCANS = 64
BEAMS_APART = 1.5
"""A direction was scanned if a beam lies within this many steps of it."""
LOOKS_RAD = math.radians(20.0)
"""The room in a direction is known only if at least one beam within this angle, or those steps, is valid."""

SLACK_BEAMS, MIN_SPAN_RAD = 2.0, math.radians(10.0)
"""Drivers of lasers disagree on angle_max by so many beams. Beams within a smaller angle show no room."""


class ScanRoom:
    """The newest scans of a robot that has a laser."""

    def __init__(self, description: RobotDescription) -> None:
        assert description.scan is not None
        self._robot, self._mount = description, description.scan
        self._clock = StampClock()
        self._at_s, self._room = -math.inf, (math.nan, math.nan)
        self._rooms: deque[tuple[float, tuple[float, float]]] = deque(maxlen=MAX_SCANS)
        """When the last scans were measured, and their room ahead and behind."""

    def take(self, payload: bytes, now: float) -> None:
        """Take a LaserScan. Raises FormatError."""
        message = decode(LASER_SCAN, payload)
        now_ns = round(now * 1e9)
        stamp_ns = read_stamp_ns(message.header)
        measured_ns = self._clock.measured_ns(stamp_ns, now_ns) if stamp_ns else now_ns
        if measured_ns is None:
            raise FormatError("its stamp jumps")
        if now - measured_ns * 1e-9 > VALID_S:
            raise FormatError(f"it is {now - measured_ns * 1e-9:.1f} s old, at most {VALID_S:g} s")
        with np.errstate(invalid="ignore"):  # a signalling NaN is one among others
            ranges = np.asarray(message.ranges, np.float64)
        step = float(message.angle_increment)
        _check(message, len(ranges))
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
        self._rooms.append((self._at_s, self._room))

    def unknown(self, now: float) -> str:
        """Return why the room ahead or behind is not known; "" if it is."""
        if self._at_s == -math.inf:
            return "no scan has come that can be used"
        if now - self._at_s > VALID_S:
            return f"the newest scan is {now - self._at_s:.1f} s old, at most {VALID_S:g} s"
        dark = [name for name, room in zip(("ahead", "behind"), self._room, strict=True) if math.isnan(room)]
        angle = round(math.degrees(LOOKS_RAD))
        return f"no beam within {angle}° of {' and '.join(dark)} has a valid range" if dark else ""

    def clear(self, now: float) -> tuple[float, float]:
        """Return the room in m from the outline to the nearest thing ahead and behind; NaN = not known."""
        if now - self._at_s > VALID_S:
            return math.nan, math.nan
        recent = [room for at_s, room in self._rooms if self._at_s - at_s <= ROUND_S]
        ahead, behind = (_nearest(side) for side in zip(*recent, strict=True))
        return ahead, behind


def _nearest(side: Sequence[float]) -> float:
    """Return the least room of some scans on one side; NaN if the newest of them does not know it."""
    return side[-1] if math.isnan(side[-1]) else min(room for room in side if not math.isnan(room))


def _check(message: Any, beams: int) -> None:
    """Raise FormatError for a scan that no laser can measure; an infinite range_max is no limit."""
    step, least, most = message.angle_increment, message.range_min, message.range_max
    first, last = message.angle_min, message.angle_max
    if not beams:
        raise FormatError("it has no beams")
    span, slack = abs(step) * (beams - 1), SLACK_BEAMS * abs(step)
    fits = abs(first + step * (beams - 1) - last) <= slack and MIN_SPAN_RAD <= span <= math.tau + slack
    if not (all(map(math.isfinite, (first, last, step))) and fits):
        words = f"it has {beams} beams from {first:.3g} to {last:.3g} rad in steps of {step:.3g} rad"
        raise FormatError(f"{words}, which do not fit: expected an angle of 0.17 to 6.28 rad")
    if not math.isfinite(least) or not most > least:
        raise FormatError(f"range_min is {least:g} and range_max {most:g}, expected range_min < range_max")


def _least(room: NDArray[np.float64]) -> float:
    return max(float(room.min()), 0.0) if len(room) else math.inf


def _scanned(angles: NDArray[np.float64], sees: NDArray[np.bool_], direction: float, step: float) -> bool:
    apart = np.abs(np.remainder(angles - direction + math.pi, math.tau) - math.pi)
    near = BEAMS_APART * abs(step)
    return bool(apart.min() <= near and np.any(sees & (apart <= max(near, LOOKS_RAD))))
