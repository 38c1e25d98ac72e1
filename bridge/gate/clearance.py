"""Clearance before and behind the base: the last range of each sonar, while it is not too old.

The base fires one sonar of each array at a time, so a report holds two or three of them; a round of an array
takes about a third of a second.
"""

import math
from collections.abc import Iterable, Mapping
from typing import NamedTuple

from bridge.pioneer.robots import RobotParameters

OLD_S = 1.0
"""A range expires after this time: three rounds."""
AHEAD_RAD = math.radians(45.0)
"""Only sonars within this angle of straight ahead or straight back are used."""


class Room(NamedTuple):
    """Shortest ranges in metres; NaN where a used sonar has sent nothing for too long."""

    ahead_m: float
    behind_m: float


class Clearance:
    """The sonars of one base. Times are seconds on any clock that does not go back."""

    def __init__(self, robot: RobotParameters) -> None:
        headings = [abs(sonar.theta) for sonar in robot.sonars]
        self._ahead = [k for k, heading in enumerate(headings) if heading <= AHEAD_RAD]
        self._behind = [k for k, heading in enumerate(headings) if heading >= math.pi - AHEAD_RAD]
        self._heard: dict[int, tuple[float, float]] = {}

    def update(self, ranges: Mapping[int, float], now: float) -> Room:
        """Add the ranges (m, by sonar) of a base report and return the clearance now."""
        self._heard |= {number: (range_m, now) for number, range_m in ranges.items()}
        return Room(self._shortest(self._ahead, now), self._shortest(self._behind, now))

    def _shortest(self, numbers: Iterable[int], now: float) -> float:
        known = [self._heard.get(number, (0.0, -math.inf)) for number in numbers]
        if any(now - heard_s > OLD_S for _, heard_s in known):
            return math.nan
        return min((range_m for range_m, _ in known), default=math.nan)
