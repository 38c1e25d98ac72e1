"""How certain it is that a rover is where its estimate says."""

import numpy as np
from numpy.typing import NDArray

from rover_ncp.core.geometry import Pose

SURE = 0.95
"""Least probability of a result that counts as certain."""
_SAMPLES = 20_000
"""Give a probability of 0.95 with a standard error of 0.0015."""


def probability_within(
    error: Pose, covariance: NDArray[np.float64], position_m: float, heading_rad: float
) -> float:
    """Return the probability that the true pose is within a distance and an angle of the goal.

    ``error`` is the estimate minus the goal, ``covariance`` (3, 3) that of its x, y and θ. The same
    arguments give the same result: the samples of the normal distribution have a fixed seed.
    """
    draws = np.random.default_rng(0).multivariate_normal(error, covariance, _SAMPLES, method="eigh")
    near = np.hypot(draws[:, 0], draws[:, 1]) <= position_m
    return float(np.mean(near & (np.abs(draws[:, 2]) <= heading_rad)))
