"""Odometry in the resolution of a Pioneer."""

import math

from rover_ncp.core.geometry import Pose, Velocity, wrap_angle

STEP_RAD = math.tau / 4096


def reported(pose, velocity):
    """Return pose and velocity in whole mm, 4096ths of a turn, whole mm/s per wheel (track 588 mm)."""
    left, right = (round(1000 * velocity.v + side * 294 * velocity.omega) / 1000 for side in (-1, 1))
    return (
        Pose(round(pose.x, 3), round(pose.y, 3), wrap_angle(STEP_RAD * round(pose.theta / STEP_RAD))),
        Velocity((left + right) / 2, (right - left) / 0.588),
    )
