"""External poses of a rover whose wheels stand: it was pushed, or the localiser is wrong."""

import math

import numpy as np
import pytest
from kit.base_odometry import started

from deploy.estimator.inputs import Acceptance
from deploy.estimator.settings import EstimatorSettings
from rover_ncp.core.geometry import Pose, Velocity

COVARIANCE = np.diag(np.square([0.005, 0.005, math.radians(0.5)]))
DT = 0.1
PUSH = np.array([0.02, -0.015, 0.05])


@pytest.mark.parametrize("noise_std", [0.0, 0.7])
def test_a_rover_that_was_pushed_while_it_stands_is_found_again(noise_std):
    rng = np.random.default_rng(7)
    estimator = standing(1.0)
    place = Pose(*PUSH)
    noise = noise_std * rng.multivariate_normal(np.zeros(3), COVARIANCE, 12)
    outcomes = [see(estimator, Pose(*(place + noise[i])), 1.0 + 0.1 * i) for i in range(12)]
    assert outcomes[:3] == [Acceptance.OUTLIER] * 3
    assert outcomes[3:] == [Acceptance.ACCEPTED] * 9
    assert not estimator.fault
    end = estimator.at(2.1)
    assert end.pose == pytest.approx(place, abs=0.007)
    assert math.sqrt(end.covariance[0, 0]) < 0.006  # its noise, and 2 mm of the source that last


@pytest.mark.parametrize(
    "seen",
    [
        # A camera that lags shows the way to where the rover stands.
        lambda i: (i + 1) * PUSH,
        lambda i: (5 - i) * PUSH,
        # Too far for a push: it was carried, or the localiser found another place.
        lambda i: np.array([0.3, 0.0, 0.0]),
        # The localiser cannot decide between two places.
        lambda i: PUSH if i % 2 else -PUSH,
    ],
    ids=["a camera that lags", "from ahead", "carried", "two places"],
)
def test_poses_that_no_push_explains_stop_a_rover_that_stands(seen):
    estimator = standing(1.0)
    before = estimator.at(1.0)
    for i in range(5):
        assert see(estimator, Pose(*seen(i)), 1.0 + 0.1 * i) is Acceptance.OUTLIER
    assert estimator.fault_rule == "external-pose"
    assert estimator.at(1.4).pose == pytest.approx(before.pose, abs=1e-9)


def standing(until_s):
    """An estimator of a rover that stands at the origin and sees it."""
    estimator = started(EstimatorSettings(), covariance=COVARIANCE)
    for tick in range(1, round(until_s / DT)):
        assert see(estimator, Pose(0.0, 0.0, 0.0), tick * DT) is Acceptance.ACCEPTED
    return estimator


def see(estimator, pose, t):
    """Odometry reports no motion, and an external pose of the same moment arrives."""
    estimator.odometry(Pose(0.0, 0.0, 0.0), Velocity(0.0, 0.0), t)
    return estimator.external(pose, COVARIANCE, t)
