"""The check of robots whose odometry or motion contradicts the commands, on the virtual clock."""

from itertools import count

import pytest
from kit.virtual_check import check

from rover_ncp.core.geometry import Pose, compose
from rover_ncp.wire.messages import odometry, read_odometry


def changed_odometry(change):
    """Return a function of odometry's bytes; ``change`` makes the pose and velocity of each sample."""
    numbers = count()

    def changed(data):
        sample = read_odometry(data)
        pose, velocity = change(sample, next(numbers))
        return odometry(pose, velocity, sample.stamp_ns)

    return changed


def jumps_while(axis):
    """Return odometry that is 0.5 m farther from the first motion on an axis on."""
    jumped = []

    def change(sample, number):
        if abs(sample.velocity[axis]) > 0.05:
            jumped.append(number)
        return compose(Pose(0.5 if jumped else 0.0, 0.0, 0.0), sample.pose), sample.velocity

    return change


@pytest.mark.parametrize(
    ("change", "name", "words"),
    [
        (jumps_while(1), "left", "the pose of odometry jumps by 0.5"),
        (
            lambda sample, _: (Pose(2.0 * sample.pose.x, sample.pose.y, sample.pose.theta), sample.velocity),
            *("forward", "has odometry another unit or scale?"),
        ),
    ],
)
def test_the_pose_of_odometry_is_compared_with_the_command_where_speeds_are_means(change, name, words):
    findings, _, _ = check(robot="husky-a200", model="husky-a200", odometry=changed_odometry(change))
    assert (findings[-1].name, findings[-1].ok) == (name, False), findings[-1].detail
    assert words in findings[-1].detail
