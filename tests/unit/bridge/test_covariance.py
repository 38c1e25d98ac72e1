"""The covariances of odometry and gyro: those of the robot's description, and never 0."""

import math

import pytest
from kit.base_report import STAMP

from bridge.base import BaseReport
from bridge.ros2 import messages as ros
from bridge.ros2.covariance import OdometryErrors
from rover_ncp.core.files import shipped_names
from rover_ncp.robot.description import load_description
from rover_ncp.wire.messages import decode

ROBOTS = pytest.mark.parametrize("name", shipped_names("robots"))


def driven(name, reports):
    """Return the variances of pose and speeds after these reports: x, y and heading of each."""
    robot = load_description(name)
    errors = OdometryErrors(robot)
    for report in reports:
        variances = errors.after(report)
    message = decode("nav_msgs/msg/Odometry", ros.each_report(report, robot, STAMP, variances)["odom"])
    return [[found.covariance[7 * k] for k in (0, 1, 5)] for found in (message.pose, message.twist)]


@ROBOTS
def test_no_variance_is_0_at_the_origin(name):
    pose, twist = driven(name, [BaseReport()])
    assert min(pose + twist) >= 1e-6


@ROBOTS
def test_the_pose_becomes_less_sure_with_the_way(name):
    before = [0.0, 0.0, 0.0]
    for way in (1, 3, 10):
        pose, _ = driven(name, [BaseReport(x=0.1 * k, v=0.1) for k in range(10 * way + 1)])
        share = load_description(name).odometry.distance_error
        assert math.sqrt(pose[0]) >= share * way / math.sqrt(3)
        assert all(new > old for new, old in zip(pose, before, strict=True))
        before = pose


@ROBOTS
def test_the_heading_becomes_less_sure_with_each_turn(name):
    pose, _ = driven(name, [BaseReport(theta=0.1 * k) for k in range(63)])
    error = load_description(name).odometry.turn_error
    assert math.sqrt(pose[2]) == pytest.approx(error * 6.2 / math.sqrt(3), rel=0.1)


def test_a_skid_steered_robot_slides_sideways_as_it_turns():
    _, skid = driven("husky-a200", [BaseReport(omega=0.5)])
    _, differential = driven("turtlebot4", [BaseReport(omega=0.5)])
    assert skid[1] == pytest.approx((0.5 * 0.256) ** 2 / 3)
    assert differential[1] == 1e-6


def test_noise_at_rest_is_no_way():
    noisy = [BaseReport(x=0.001 * (k % 3), theta=0.002 * (k % 2)) for k in range(10_000)]
    pose, _ = driven("turtlebot3-burger", noisy)
    assert max(pose) < 1e-5


def test_odometry_that_was_reset_is_sure_again_and_nan_does_not_stay():
    reports = [*(BaseReport(x=0.1 * k) for k in range(100)), BaseReport(x=math.nan), BaseReport()]
    pose, _ = driven("turtlebot4", reports)
    assert max(pose) < 1e-5


def test_the_gyros_variance_is_the_robots():
    for name, variance in (("husky-a200", 0.005**2), ("p3at-sh", 1e-6)):
        message = decode("sensor_msgs/msg/Imu", ros.turn_rate(0.1, load_description(name), STAMP))
        assert message.angular_velocity_covariance[8] == pytest.approx(variance)
