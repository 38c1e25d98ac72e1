"""Variances of a robot's odometry, by its description. Pure.

Odometry has no covariance of its own. The variances of the pose grow with each metre and each radian since
its origin. The variance of each speed grows with the square of that speed; that of the lateral speed with ω².
`distance_error` and `turn_error` are half-widths of uniform distributions: σ = width/√3.
"""

import math
from typing import NamedTuple

from bridge.base import BaseReport
from rover_ncp.core.geometry import Pose, distance
from rover_ncp.robot.description import RobotDescription

MIN_VARIANCE = 1e-6
"""Lower bound of every variance (SI squared): other filters read 0 as certain or unknown."""
MOVED_M, MOVED_RAD = 0.02, 0.02
"""Smallest motion that counts, in m and rad: noise at rest must not add up."""


class Variances(NamedTuple):
    """Variances of one report."""

    pose: tuple[float, float, float]
    """Of x and y in m², of the heading in rad²."""
    velocity: tuple[float, float]
    """Of v in (m/s)², of ω in (rad/s)²."""
    lateral: float
    """Of the speed to the side, in (m/s)²."""


class OdometryErrors:
    """The growing errors of one robot's odometry, from its origin on."""

    def __init__(self, robot: RobotDescription) -> None:
        odometry = robot.odometry
        self._noise = odometry.noise_m**2, odometry.noise_rad**2
        self._per_m = odometry.distance_error / math.sqrt(3)
        self._per_rad = odometry.turn_error / math.sqrt(3)
        # The odometry's track, by which wheels of different sizes turn the heading; skid steering widens it.
        self._track_m = robot.track_m
        # A skid-steered robot turns about a point anywhere between its axles, and slides sideways meanwhile.
        # A differential drive has one axle: its lateral variance is the minimum.
        self._lateral_m = robot.wheels.axles_m / 2 / math.sqrt(3)
        self._last = Pose(0.0, 0.0, 0.0)
        self._distance_m = self._turned_rad = 0.0

    def after(self, report: BaseReport) -> Variances:
        """Return the variances of the next report, whose heading must not be wrapped.

        A pose of exactly zero counts as a reset of the odometry: the errors begin again at zero.
        """
        pose = Pose(report.x, report.y, report.theta)
        distance_m, turned_rad = distance(pose, self._last), abs(pose.theta - self._last.theta)
        if not any(pose):
            self._last, self._distance_m, self._turned_rad = pose, 0.0, 0.0
        elif math.isfinite(distance_m + turned_rad) and (distance_m > MOVED_M or turned_rad > MOVED_RAD):
            self._last = pose
            self._distance_m += distance_m
            self._turned_rad += turned_rad
        by_turns, by_wheels = self._per_rad * self._turned_rad, self._per_m * self._distance_m / self._track_m
        heading = by_turns**2 + by_wheels**2
        # A heading error that grows along a distance d displaces the position sideways. The variance of that
        # is d² var(heading) / 4 for a steady growth and / 3 for a random walk: the larger one counts.
        position = _variance(self._noise[0] + self._distance_m**2 * (self._per_m**2 + heading / 3))
        return Variances(
            (position, position, _variance(self._noise[1] + heading)),
            (_variance((self._per_m * report.v) ** 2), _variance((self._per_rad * report.omega) ** 2)),
            _variance((self._lateral_m * report.omega) ** 2),
        )


def _variance(value: float) -> float:
    return max(value, MIN_VARIANCE)
