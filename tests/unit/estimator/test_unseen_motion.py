"""Errors of a robot and its gyro that no sensor shows: the covariance covers them, by a state for each."""

import math

import numpy as np
import pytest
from kit.base_odometry import moved, reported, started
from scipy.stats import chi2

from deploy.estimator.settings import EstimatorSettings
from rover_ncp.core.geometry import Pose, Velocity, wrap_angle

PERIOD_S, TURN_GAIN = 0.1, 1.3
RAMP_RAD_S2 = math.radians(0.5) / 22.0
ARC = (2.0, 0.0, 0.0), (9.0, 0.03, 0.3)
SLALOM = (3.0, 0.0, 0.0), (6.0, 0.1, 0.1), (10.0, 0.1, 0.2), (7.0, 0.1, -0.2)
"""Seconds, speed in m/s and turn rate in rad/s."""


def squared_errors(settings, ways, *, behind=0.0, left=0.0, scale=0.0, ramp=0.0):
    """Drive with a gyro; return the squared errors of position and heading over their covariance."""
    estimator = started(settings)
    true = own = Pose(0.0, 0.0, 0.0)
    motion = [(v, omega) for seconds, v, omega in ways for _ in range(round(seconds / PERIOD_S))]
    for tick, (v, omega) in enumerate(motion, 1):
        t = tick * PERIOD_S
        turn, ahead = omega * PERIOD_S, v * PERIOD_S
        true = moved(true, turn, ahead + left * turn, behind * turn)
        own = moved(own, turn / TURN_GAIN, ahead)
        estimator.gyro(omega / (1.0 + scale) + 0.05 + ramp * t, t)
        estimator.odometry(*reported(own, Velocity(v, omega / TURN_GAIN)), t)
    estimate = estimator.at(t)
    assert not estimator.fault
    error = np.array(estimate.pose) - true
    error[2] = wrap_angle(error[2])
    position = error[:2] @ np.linalg.solve(estimate.covariance[:2, :2], error[:2])
    return float(position), float(error[2] ** 2 / estimate.covariance[2, 2])


@pytest.mark.parametrize(
    ("error", "size", "state", "ways"),
    [
        ("behind", 0.13, "rotation_center_std_m", ARC),
        ("left", 0.056, "rotation_center_left_std_m", ARC),
        ("scale", 0.03, "gyro_scale_std", ARC),
        ("ramp", RAMP_RAD_S2, "gyro_bias_walk_rad_s", SLALOM),
    ],
)
def test_covariance_covers_an_unseen_error_by_its_state(error, size, state, ways):
    limits = chi2.ppf(0.95, [2, 1])
    assert (np.array(squared_errors(EstimatorSettings(), ways, **{error: size})) < limits).all()
    # A turn gain that is not the expected one widens the centre of rotation by itself.
    fixed = {"half_wheelbase_m": 0.0, "half_track_m": 1e-9}
    without = EstimatorSettings().model_copy(update={state: 1e-9} | fixed)
    assert (np.array(squared_errors(without, ways, **{error: size})) > limits).any()
