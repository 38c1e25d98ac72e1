"""Shapes of a course: outlines of robots and obstacles, and the places of its deadlines."""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from rover_ncp.core.files import DEFAULT_ROBOT
from rover_ncp.robot.description import Circle, RobotDescription, load_description

FloatArray = NDArray[np.float64]

_UNIT = np.array([[1, 1], [1, -1], [-1, -1], [-1, 1], [1, 1]]) / 2
_SIDES = 36
"""Of a round outline."""


def outline_of(robot: RobotDescription) -> FloatArray:
    """Return a robot's outline (n, 2) in its own frame, closed, in m; the first two points are its front."""
    if isinstance(robot.footprint, Circle):
        turns = np.linspace(0.0, math.tau, _SIDES + 1) + math.pi / _SIDES
        return robot.footprint.radius_m * np.column_stack([np.cos(turns), np.sin(turns)])[::-1]
    front, rear, half = robot.front_m, -robot.rear_m, robot.width_m / 2
    return np.array([[front, half], [front, -half], [rear, -half], [rear, half], [front, half]])


OUTLINE = outline_of(load_description(DEFAULT_ROBOT))
"""That of the robot that courses and policies were made for."""


def placed(corners: FloatArray, pose: Sequence[float]) -> FloatArray:
    """Transform corners (k, 2) from a body's frame into the frame of its pose."""
    c, s = np.cos(pose[2]), np.sin(pose[2])
    moved: FloatArray = corners @ np.array([[c, s], [-s, c]]) + np.asarray(pose[:2])
    return moved


def rectangle(length: float, width: float, pose: Sequence[float]) -> FloatArray:
    """Return the corners (5, 2) of a rectangle, closed."""
    return placed(_UNIT * [length, width], pose)


def at_places(points: Sequence[tuple[float, float, float]]) -> list[tuple[float, float, str]]:
    """Return the places x, y of points (x, y, t) with their times in words, that of most points first.

    A drawing skips labels that would cover one of an earlier place.
    """
    places: dict[tuple[float, float], list[float]] = {}
    for x, y, t in points:
        places.setdefault((round(x, 3), round(y, 3)), []).append(t)
    ordered = sorted(places.items(), key=lambda item: -len(item[1]))
    return [
        (x, y, f"{times[0]:.0f} s" if len(times) == 1 else f"{times[0]:.0f} to {times[-1]:.0f} s")
        for (x, y), times in ordered
    ]
