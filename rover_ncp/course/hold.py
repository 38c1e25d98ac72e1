"""The hold at the end of a course: near the goal, small commands follow only noise of the observed pose.

``episode.cpp`` of the native library repeats `holds`.
"""

import math

from rover_ncp.core.geometry import Velocity
from rover_ncp.course.course import Course

HOLD = Velocity(0.004, math.radians(1.0))
"""A rover near its goal begins to hold when both commands are smaller. A base with a dead band also holds
where commands would be pulses, as each moves it by more than the policy commands."""
COMING_TO_REST_S = 1.0
"""Time to come to rest before the verdict's standstill; until then, small commands correct the pose."""


def hold_from_s(course: Course) -> float:
    """Return the time in s after which a rover on the course may hold."""
    return course.horizon_s - course.parked.still_s - COMING_TO_REST_S


def holds(v: float, omega: float, least: Velocity, near_goal: bool, held: bool) -> bool:
    """Return whether a rover holds in this tick; ``least`` is the `HOLD` of its base, or more.

    ``held`` is whether it held in the tick before. Only a rover that leaves the goal ends its hold.
    """
    return near_goal and (held or (abs(v) < least.v and abs(omega) < least.omega))
