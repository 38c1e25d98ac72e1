"""Addresses of ROS 2 robots, their topics and their tokens."""

import pytest

from bridge.bases import choose_base
from bridge.ros2.address import RosAddress, parse_ros_address
from bridge.ros2.discovery import Announced, read_topic_token, topic_token
from bridge.ros2.rmw import Graph, Topic, read_token
from rover_ncp.core.errors import ConfigError, UsageError


def test_addresses():
    assert parse_ros_address("ros2/tcp/robot") == RosAddress("tcp/robot:7447")
    found = parse_ros_address("ros2/tcp/[::1]:8000#rmw=zenoh&domain=7&namespace=/a200_0001")
    assert (found.endpoint, found.domain, found.namespace) == ("tcp/[::1]:8000", 7, "a200_0001")
    assert found.convention == "rmw-zenoh"


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


def test_tokens_are_read_as_they_are_written():
    token = topic_token("abc", "bot1/cmd_vel", "geometry_msgs/msg/Twist", published=True)
    assert read_topic_token(token) == Announced(
        "abc", True, "bot1/cmd_vel", "geometry_msgs/msg/Twist", "zenoh-bridge-ros2dds abc"
    )
    graph = Graph(3, "abc", "bot1", "teleop")
    found = read_token(graph.subscriber_token(5, Topic("bot1/cmd_vel", "geometry_msgs/msg/TwistStamped")))
    assert found == Announced("abc", False, "bot1/cmd_vel", "geometry_msgs/msg/TwistStamped", "/bot1/teleop")
    assert read_token(graph.node_token()) is None
    assert read_topic_token("@/abc/@ros2_lv") is None


def test_an_address_names_topics_of_its_own():
    found = choose_base("ros2/tcp/robot#odom=/wheels/odom&imu=&cmd_vel_type=Twist", "turtlebot3-burger")
    topics = found.description.topics
    assert (topics.odom, topics.imu, topics.cmd_vel_type) == ("wheels/odom", None, "Twist")
    assert topics.battery_state == "battery_state"  # as it is described
    with pytest.raises(ConfigError, match=r"\$.cmd_vel_type"):
        choose_base("ros2/tcp/robot#cmd_vel_type=Pose", "turtlebot3-burger")


def test_keys_of_humble_have_no_type_hash():
    plain = Topic("odom", "nav_msgs/msg/Odometry", hashed=False)
    assert plain.key(0) == "0/odom/nav_msgs::msg::dds_::Odometry_/TypeHashNotSupported"
    assert "/TypeHashNotSupported/" in Graph(0, "abc").subscriber_token(1, plain)
    assert not parse_ros_address("ros2/tcp/robot#rmw=zenoh&distro=humble").hashed
