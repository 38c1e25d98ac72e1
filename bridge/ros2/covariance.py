"""How sure a robot's odometry is, by its description. Pure.

Odometry has no covariance of its own: the pose becomes less sure with each metre and each radian since its
origin, and the speeds with each other's size. An error within ± a share counts as uniform.
"""

import math
from typing import NamedTuple

from bridge.base import BaseReport
from rover_ncp.core.geometry import Pose, distance
from rover_ncp.robot.description import RobotDescription

MIN_VARIANCE = 1e-6
"""Filters of others take a variance of 0 for certainty, or for not known."""
MOVED_M, MOVED_RAD = 0.02, 0.02
"""A motion counts once it is so large: noise at rest is none."""


class Variances(NamedTuple):
    """Variances of one report's (x, y, heading), (v, ω) and speed to the side; SI squared."""

    pose: tuple[float, float, float]
    velocity: tuple[float, float]
    lateral: float


class OdometryErrors:
    """The growing errors of one robot's odometry, from its origin on."""

    def __init__(self, robot: RobotDescription) -> None:
        odometry, wheels = robot.odometry, robot.wheels
        self._noise = odometry.noise_m**2, odometry.noise_rad**2
        self._per_m = odometry.distance_error / math.sqrt(3)
        self._per_rad = odometry.turn_error / math.sqrt(3)
        self._track_m = wheels.track_m
        # A skid-steered robot turns about a point anywhere between its axles, and slides sideways meanwhile.
        self._lateral_m = wheels.axles_m / 2 / math.sqrt(3)
        self._last = Pose(0.0, 0.0, 0.0)
        self._way_m = self._turned_rad = 0.0

    def after(self, report: BaseReport) -> Variances:
        """Return the variances of the next report. Odometry that was reset begins again at zero."""
        pose = Pose(report.x, report.y, report.theta)
        way_m, turned_rad = distance(pose, self._last), abs(pose.theta - self._last.theta)
        if not any(pose):
            self._last, self._way_m, self._turned_rad = pose, 0.0, 0.0
        elif math.isfinite(way_m + turned_rad) and (way_m > MOVED_M or turned_rad > MOVED_RAD):
            self._last = pose
            self._way_m += way_m
            self._turned_rad += turned_rad
        heading = (self._per_rad * self._turned_rad) ** 2 + (self._per_m * self._way_m / self._track_m) ** 2
        place = _variance(self._noise[0] + self._way_m**2 * (self._per_m**2 + heading / 3))
        return Variances(
            (place, place, _variance(self._noise[1] + heading)),
            (_variance((self._per_m * report.v) ** 2), _variance((self._per_rad * report.omega) ** 2)),
            _variance((self._lateral_m * report.omega) ** 2),
        )


def _variance(value: float) -> float:
    return max(value, MIN_VARIANCE)
