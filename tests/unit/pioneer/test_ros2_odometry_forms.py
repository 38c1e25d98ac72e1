"""Odometry of a simulated ROS 2 robot: mean speeds and a coarse heading, as described."""

import math

import pytest

from rover_ncp.core.geometry import Velocity
from rover_ncp.robot.description import load_description
from rover_ncp.wire.messages import read_odometry, twist_stamped
from sim.pioneer.ros2_robot import Ros2Robot
from sim.world.described import described_rover
from sim.world.pymunk_rover import Ground, PymunkRover


def reports(**odometry):
    """Return time and odometry of a Husky that drives an arc for 3 s, then halts."""
    husky = load_description("husky-a200")
    changed = {"noise_m": 0.0, "noise_rad": 0.0, **odometry}
    husky = husky.model_copy(update={"odometry": husky.odometry.model_copy(update=changed)})
    robot = Ros2Robot(husky, PymunkRover(described_rover(husky), Ground(())))
    found = []
    for tick in range(50):
        t = 0.1 * tick
        robot.advance(t)
        found += [(t, read_odometry(data)) for topic, data in robot.messages() if topic.endswith("odom")]
        if tick < 30:
            robot.command(twist_stamped(Velocity(0.3, 0.2), round(t * 1e9)), t)
    return found


def test_speeds_are_means_over_the_described_time():
    now, mean = reports(speed_mean_s=0.0), reports(speed_mean_s=1.0)
    assert [sample.pose for _, sample in now] == [sample.pose for _, sample in mean]
    for number in range(20, len(now)):
        for axis in (0, 1):
            expected = sum(sample.velocity[axis] for _, sample in now[number - 19 : number + 1]) / 20
            assert mean[number][1].velocity[axis] == pytest.approx(expected, abs=0.012)
    assert max(sample.velocity.v for _, sample in mean) == pytest.approx(0.3, abs=0.001)
    assert mean[-1][1].velocity.v == pytest.approx(0.0, abs=1e-9)


def test_heading_is_reported_in_the_described_steps():
    step = math.radians(0.35)
    fine, coarse = reports(), reports(heading_step_rad=step)
    for (_, sample), (_, rounded) in zip(fine, coarse, strict=True):
        steps = rounded.pose.theta / step
        assert steps == pytest.approx(round(steps), abs=1e-9)
        assert abs(rounded.pose.theta - sample.pose.theta) <= step / 2 + 1e-9
