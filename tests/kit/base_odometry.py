"""Odometry in the resolution of a Pioneer, and an estimator for it."""

import math

import numpy as np

from deploy.estimator.estimator import Estimator
from rover_ncp.core.geometry import Pose, Velocity, compose, wrap_angle
from rover_ncp.robot.lasting_error import Kind, LastingError

MOTION_CAPTURE = LastingError(kind=Kind.MOTION_CAPTURE)
STEP_RAD = math.tau / 4096
DT = 0.1
POSE_COVARIANCE = np.diag(np.square([0.005, 0.005, math.radians(0.5)]))


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


def started(settings=None, heading=0.0, covariance=None, lasting=MOTION_CAPTURE):
    """Return an estimator of a rover that stands at the origin at time 0."""
    estimator = Estimator(settings)
    estimator.start(Pose(0.0, 0.0, heading), 0.0, covariance=covariance, lasting=lasting)
    return estimator


def straight(until_s, settings=None, covariance=POSE_COVARIANCE):
    """Return an estimator of a rover that drives straight ahead from time 0 as `way_m` says."""
    estimator = started(settings, covariance=covariance)
    for tick in range(1, round(until_s / DT) + 1):
        t = tick * DT
        estimator.odometry(Pose(way_m(t), 0.0, 0.0), Velocity(min(0.1, 0.3 * t), 0.0), t)
    return estimator


def way_m(t):
    """Return the way at 0.1 m/s, reached with 0.3 m/s²."""
    return 0.15 * t * t if t < 1 / 3 else 0.1 * t - 1 / 60
