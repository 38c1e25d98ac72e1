"""Odometry in the resolution of a Pioneer."""

import math

from rover_ncp.core.geometry import Pose, Velocity, compose, wrap_angle

STEP_RAD = math.tau / 4096


def reported(pose, velocity):
    """Return pose and velocity in whole mm, 4096ths of a turn, whole mm/s per wheel (track 588 mm)."""
    left, right = (round(1000 * velocity.v + side * 294 * velocity.omega) / 1000 for side in (-1, 1))
    return (
        Pose(round(pose.x, 3), round(pose.y, 3), wrap_angle(STEP_RAD * round(pose.theta / STEP_RAD))),
        Velocity((left + right) / 2, (right - left) / 0.588),
    )


def moved(pose, turn, ahead, left=0.0):
    """Return a pose after a step, in rad and m, by the heading at half of its turn."""
    middle = compose(pose, Pose(0.0, 0.0, 0.5 * turn))
    return compose(middle, Pose(ahead, left, 0.5 * turn))
