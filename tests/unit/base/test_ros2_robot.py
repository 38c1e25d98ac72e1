"""A simulated ROS 2 robot: its odometry as described, faults of its clock and of its gyro."""

from itertools import pairwise

import pytest
from kit.described import described
from kit.ros2_world import twist

from rover_ncp.core.geometry import Velocity
from rover_ncp.robot.description import load_description
from rover_ncp.wire.messages import read_imu, read_odometry, twist_stamped
from sim.base.faults import Faults, parse_fault
from sim.base.ros2_robot import Ros2Robot
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


def faulty(fault):
    """Return what a ROS 2 robot sends in 4 s; a fault counts from its first command."""
    description = described("turtlebot4", topics={"cmd_vel_type": "Twist"})
    rover = PymunkRover(described_rover(description), Ground())
    robot = Ros2Robot(description, rover, Faults([parse_fault(fault)]), 0.0)
    for period in range(1, 41):
        robot.command(twist(Velocity(0.1, 0.0)), period / 10)
    return robot.messages()


def test_readings_of_a_gyro_are_late_and_those_on_their_way_are_lost_in_silence():
    newest_ns, behind_ms, stamps_s = None, set(), []
    for name, data in faulty("mute@2-2.5"):
        if name == "imu":
            newest_ns = read_imu(data).stamp_ns
            stamps_s.append(newest_ns / 1e9)
        elif name == "odom" and newest_ns is not None:
            behind_ms.add((read_odometry(data).stamp_ns - newest_ns) // 1_000_000)
    assert min(behind_ms) >= 20
    before, after = next(pair for pair in pairwise(stamps_s) if pair[1] - pair[0] > 0.3)
    # The fault begins 2 s after the first command, which is given at 0.1 s.
    assert (before, after) == (pytest.approx(2.08, abs=0.011), pytest.approx(2.6, abs=0.011))
