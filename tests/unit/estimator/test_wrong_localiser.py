"""External poses of localisers that are wrong in a way that single poses do not show."""

import numpy as np
import pytest
from kit.base_odometry import DT, POSE_COVARIANCE, moved, started, straight, way_m

from deploy.estimator.inputs import Acceptance
from rover_ncp.core.geometry import Pose, Velocity


def test_many_rejections_among_accepted_poses_are_a_fault():
    estimator = straight(1.0)
    wrong, right = Pose(way_m(1.0), 0.3, 0.0), Pose(way_m(1.0), 0.0, 0.0)
    for number in range(19):
        assert not estimator.fault
        estimator.external(right if number % 2 else wrong, POSE_COVARIANCE, 1.0)
    assert (estimator.fault_rule, estimator.fault) == (
        "external-pose",
        "10 of the last 19 external poses rejected",
    )


AHEAD = Velocity(0.1, 0.0)


def drive_on(estimator, seconds, see, velocity=AHEAD):
    """Drive from where `straight` ends after 1 s; ``see`` returns the external pose at a true one."""
    pose = Pose(way_m(1.0), 0.0, 0.0)
    for tick in range(1, round(seconds / DT) + 1):
        pose = moved(pose, velocity.omega * DT, velocity.v * DT)
        t = 1.0 + tick * DT
        estimator.odometry(pose, velocity, t)
        estimator.external(see(pose), POSE_COVARIANCE, t)
        if estimator.fault:
            return pose
    return pose


def test_localiser_that_repeats_an_old_pose_while_the_rover_drives_is_a_fault():
    estimator, frozen = straight(1.0), Pose(way_m(1.0) + 0.01, 0.0, 0.0)
    end = drive_on(estimator, 5.0, lambda pose: frozen)
    assert estimator.poses[Acceptance.REPEATED] == 5
    assert "the same pose again, although odometry moved" in estimator.fault
    assert end.x - frozen.x < 0.1


def test_localiser_without_noise_may_repeat_the_pose_of_a_rover_that_stands():
    estimator = started(covariance=POSE_COVARIANCE)
    for tick in range(1, 50):
        estimator.odometry(Pose(0.0, 0.0, 0.0), Velocity(0.0, 0.0), tick * DT)
        assert estimator.external(Pose(0.001, 0.0, 0.0), POSE_COVARIANCE, tick * DT) is Acceptance.ACCEPTED


def test_poses_of_a_mirrored_frame_are_a_fault():
    noise, estimator = np.random.default_rng(1), straight(1.0)

    def see(pose):
        return Pose(*(np.array([pose.x, -pose.y, -pose.theta]) + noise.normal(0.0, 0.002, 3)))

    end = drive_on(estimator, 10.0, see, Velocity(0.0, 0.2))
    assert estimator.fault_rule == "external-pose"
    assert "is their frame turned or mirrored" in estimator.fault
    assert end.theta < 1.0


@pytest.mark.parametrize(("late_s", "stops"), [(0.5, False), (1.0, True)])
def test_a_few_late_poses_do_not_stop_a_rover_that_begins_to_turn(late_s, stops):
    """They look like a rover that does not turn. Without a gyro nothing else shows the turn."""
    noise, estimator, seen = np.random.default_rng(1), straight(1.0), []

    def see(pose):
        seen.append(np.array(pose))
        late = seen[max(0, len(seen) - 1 - round(late_s / DT))]
        return Pose(*(late + noise.normal(0.0, 0.002, 3)))

    drive_on(estimator, 10.0, see, Velocity(0.0, 0.4))
    assert bool(estimator.fault) is stops
    assert not stops or "are they late" in estimator.fault
