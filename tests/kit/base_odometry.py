"""Odometry in the resolution of a Pioneer, and an estimator for it."""

import math

from deploy.estimator.estimator import Estimator
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


def started(settings=None, heading=0.0, covariance=None):
    """Return an estimator of a rover that stands at the origin at time 0."""
    estimator = Estimator(settings)
    estimator.start(Pose(0.0, 0.0, heading), 0.0, covariance=covariance)
    return estimator
