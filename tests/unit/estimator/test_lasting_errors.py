"""Errors that last: of external poses, and of a floor that changes on the way."""

import math

import numpy as np
import pytest
from kit.base_odometry import DT, MOTION_CAPTURE, moved, reported, started

from rover_ncp.core.geometry import Pose, Velocity, distance
from rover_ncp.robot.lasting_error import UNDECLARED, LastingError

WHITE = 0.005, 0.005, math.radians(0.3)
SEEN = np.diag(np.square(WHITE))


def localised(lasting, bias, seconds=40.0, seen=SEEN):
    """Drive a circle; return errors (n, 3), standard deviations (n, 3) and the estimator.

    ``bias(t)`` is the error of the poses at ``t`` s beside their white noise.
    """
    rng = np.random.default_rng(3)
    true = Pose(0.0, 0.0, 0.0)
    estimator = started(covariance=seen, lasting=lasting)
    errors, deviations = [], []
    for tick in range(1, round(seconds / DT) + 1):
        t = tick * DT
        true = moved(true, 0.1 * DT, 0.1 * DT)
        estimator.odometry(*reported(true, Velocity(0.1, 0.1)), t)
        if tick % 2 == 0:
            estimator.external(Pose(*(np.array(true) + bias(t) + WHITE * rng.normal(size=3))), seen, t)
        estimate = estimator.at(t)
        errors.append(np.array(estimate.pose) - true)
        deviations.append(np.sqrt(np.diag(estimate.covariance))[:3])
    return np.array(errors), np.array(deviations), estimator


def test_what_all_poses_have_in_common_is_never_averaged_away():
    lasting = LastingError(position_m=0.05, heading_rad=0.03, time_s=1e5)
    _, deviations, _ = localised(lasting, lambda t: np.zeros(3))
    assert deviations[-1, :2].min() > 0.045
    _, deviations, _ = localised(MOTION_CAPTURE, lambda t: np.zeros(3))
    assert deviations[-1, :2].max() < 0.004


def test_poses_of_a_source_that_declares_nothing_leave_the_estimate_uncertain():
    _, deviations, _ = localised(UNDECLARED, lambda t: np.zeros(3))
    assert deviations[-1, :2].min() > 0.04  # 10 cm with 95 % take 0.04 m
    told = np.diag(np.square([0.3, 0.3, 0.2]))
    _, deviations, _ = localised(UNDECLARED, lambda t: np.zeros(3), seen=told)
    assert deviations[-1, :2].min() > 0.15  # its covariance may be that of a lasting error


@pytest.mark.parametrize("size_m", [0.02, 0.04])
def test_poses_that_err_longer_than_declared_make_the_estimate_less_certain(size_m):
    def drifts(t):
        return np.array([size_m * math.sin(0.4 * t), size_m * math.sin(0.3 * t), 0.0])

    errors, deviations, estimator = localised(MOTION_CAPTURE, drifts)
    assert not estimator.fault
    late = slice(len(errors) // 2, None)
    assert (np.abs(errors[late, :2]) < 3.0 * deviations[late, :2]).all()
    assert deviations[-1, :2].min() > 0.006  # more than of poses without such an error
    # The source had that error when it showed a place, too.
    assert estimator.lasting_covariance[0, 0] >= (2.0 * MOTION_CAPTURE.values.position_m) ** 2


@pytest.mark.parametrize(("gain", "aside_m"), [(1.5, 0.0), (0.5, 0.4)])
def test_another_floor_is_followed_and_makes_the_place_uncertain(gain, aside_m):
    """On the second half of the way wheels slip: the turn gain changes, and the centre of rotation moves."""
    true, own, estimator = Pose(0.0, 0.0, 0.0), Pose(0.0, 0.0, 0.0), started()
    before = None
    for tick in range(1, 161):
        slips = tick > 80
        turn = 0.2 * DT
        true = moved(
            true, turn * (gain if slips else 1.0), 0.05 * DT - (aside_m * turn * gain if slips else 0.0)
        )
        own = moved(own, turn, 0.05 * DT)
        estimator.gyro(0.2 * (gain if slips else 1.0), tick * DT)
        estimator.odometry(*reported(own, Velocity(0.05, 0.2)), tick * DT)
        if tick == 80:
            before = estimator.at(8.0)
    after = estimator.at(16.0)
    assert not estimator.fault
    assert after.turn_gain == pytest.approx(gain, rel=0.1)
    assert abs(after.pose.theta - true.theta) < 0.1
    assert distance(after.pose, true) < 2.0 * after.error_95_m
    assert after.error_95_m > 1.5 * before.error_95_m
