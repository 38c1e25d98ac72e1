"""Variances of a robot's odometry: constants of its description. Pure.

`distance_error` and `turn_error` are half-widths of uniform distributions: σ = width/√3.
"""

import math
from typing import NamedTuple

from rover_ncp.robot.description import RobotDescription

MIN_VARIANCE = 1e-6
"""Lower bound of every variance (SI squared): other filters read 0 as certain or unknown."""


class Variances(NamedTuple):
    """Variances of each report."""

    pose: tuple[float, float, float]
    """Of x and y in m², of the heading in rad²: noise, and the errors of 1 m and of a turn of 1 rad."""
    velocity: tuple[float, float]
    """Of v in (m/s)², of ω in (rad/s)²: the errors at the greatest speeds."""
    lateral: float
    """Of the speed to the side, in (m/s)²."""


def odometry_variances(robot: RobotDescription) -> Variances:
    """Return the variances of a robot's odometry."""
    odometry, motion = robot.odometry, robot.motion
    per_m, per_rad = odometry.distance_error / math.sqrt(3), odometry.turn_error / math.sqrt(3)
    # A skid-steered robot turns about a point anywhere between its axles, and slides sideways meanwhile.
    # A differential drive has one axle: its lateral variance is the minimum.
    lateral_m = robot.wheels.axles_m / 2 / math.sqrt(3)
    position = _variance(odometry.noise_m, per_m)
    # The odometry's track, by which wheels of different sizes turn the heading; skid steering widens it.
    heading = _variance(odometry.noise_rad, per_rad, per_m / robot.track_m)
    return Variances(
        (position, position, heading),
        (_variance(per_m * motion.v_max), _variance(per_rad * motion.omega_max)),
        _variance(lateral_m * motion.omega_max),
    )


def _variance(*deviations: float) -> float:
    return max(sum(value * value for value in deviations), MIN_VARIANCE)
