"""Addresses of ROS 2 robots and their topics."""

import pytest

from bridge.bases import choose_base
from bridge.ros2.address import RosAddress, parse_ros_address
from rover_ncp.core.errors import ConfigError, UsageError


def test_addresses():
    assert parse_ros_address("ros2/tcp/robot") == RosAddress("tcp/robot:7447")
    found = parse_ros_address("ros2/tcp/[::1]:8000#rmw=zenoh&domain=7&namespace=/a200_0001")
    assert (found.endpoint, found.domain, found.namespace) == ("tcp/[::1]:8000", 7, "a200_0001")
    assert (found.convention, found.hashed) == ("rmw-zenoh", True)
    assert not parse_ros_address("ros2/tcp/robot#rmw=zenoh&distro=humble").hashed


@pytest.mark.parametrize(
    "text",
    [
        *("ros2/", "ros2/tcp/", "ros2/udp/x", "ros2/tcp/x:0", "ros2/tcp/x:y", "ros2/tcp/x#rmw=dds"),
        *("ros2/tcp/x#domain=-1", "ros2/tcp/x#domain=233", "ros2/tcp/x#speed=9", "ros2/tcp/x#domain=²"),
    ],
)
def test_bad_addresses_are_refused(text):
    with pytest.raises(UsageError, match="expected ros2/tcp/HOST"):
        parse_ros_address(text)


def test_an_address_names_topics_of_its_own():
    found = choose_base("ros2/tcp/robot#odom=/wheels/odom&imu=&cmd_vel_type=Twist", "turtlebot3-burger")
    topics = found.description.topics
    assert (topics.odom, topics.imu, topics.cmd_vel_type) == ("wheels/odom", None, "Twist")
    assert topics.battery_state == "battery_state"  # as it is described
    with pytest.raises(ConfigError, match=r"\$.cmd_vel_type"):
        choose_base("ros2/tcp/robot#cmd_vel_type=Pose", "turtlebot3-burger")
