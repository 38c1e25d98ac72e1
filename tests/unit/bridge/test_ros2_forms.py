"""Keys, tokens and attachments of ROS 2 on Zenoh, by hand, in the forms of both integrations."""

import struct

import pytest
import zenoh.ext

from bridge.ros2.address import RosAddress, parse_ros_address
from bridge.ros2.discovery import Announced, bridge_token, read_topic_token, topic_token
from bridge.ros2.rmw import Attachment, Graph, Topic, gid, read_token
from rover_ncp.core.errors import UsageError

# Type hashes as ROS 2 Jazzy's own packages carry them.
STRING = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"
ODOMETRY = "RIHS01_3cc97dc7fb7502f8714462c526d369e35b603cfc34d946e3f2eda2766dfec6e0"


def test_tokens_are_read_as_they_are_written():
    token = topic_token("abc", "bot1/cmd_vel", "geometry_msgs/msg/Twist", published=True)
    assert read_topic_token(token) == Announced(
        "abc", True, "bot1/cmd_vel", "geometry_msgs/msg/Twist", "zenoh-bridge-ros2dds abc"
    )
    graph = Graph(3, "abc", "bot1", "teleop")
    token = graph.topic_token(5, Topic("bot1/cmd_vel", "geometry_msgs/msg/TwistStamped"), published=False)
    assert read_token(token) == Announced(
        "abc", False, "bot1/cmd_vel", "geometry_msgs/msg/TwistStamped", "/bot1/teleop", gid(token)
    )
    assert read_token(graph.node_token()) is None
    assert read_topic_token("@/abc/@ros2_lv") is None


@pytest.mark.parametrize(
    ("topic", "ros_type", "options", "token"),
    [
        ("odom", "nav_msgs/msg/Odometry", {"published": True}, "MP/odom/nav_msgs§msg§Odometry/:1:0:0,10"),
        ("a/cmd", "nav_msgs/msg/Path", {"published": False}, "MS/a§cmd/nav_msgs§msg§Path/:1:0:0,10"),
        ("tf", "a/msg/Tf", {"published": True, "latched": True}, "MP/tf/a§msg§Tf/:1:1:0,1"),
    ],
)
def test_tokens_have_the_form_that_zenoh_bridge_ros2dds_reads(topic, ros_type, options, token):
    # The examples of zenoh-plugin-ros2dds' own source and issue 213.
    assert bridge_token("abc") == "@/abc/@ros2_lv"
    assert topic_token("abc", topic, ros_type, **options) == f"@/abc/@ros2_lv/{token}"


def test_a_topics_key_has_domain_name_type_and_hash_if_it_has_one():
    chatter = Topic("chatter", "std_msgs/msg/String")
    assert chatter.key(0) == f"0/chatter/std_msgs::msg::dds_::String_/{STRING}"
    odom = Topic("bot1/odom", "nav_msgs/msg/Odometry")
    assert odom.key(42) == f"42/bot1/odom/nav_msgs::msg::dds_::Odometry_/{ODOMETRY}"
    humble = Topic("odom", "nav_msgs/msg/Odometry", hashed=False)
    assert humble.key(0) == "0/odom/nav_msgs::msg::dds_::Odometry_/TypeHashNotSupported"
    assert "/TypeHashNotSupported/" in Graph(0, "abc").topic_token(1, humble, published=False)


def test_tokens_have_the_form_that_rmw_zenoh_reads():
    chatter = Topic("chatter", "std_msgs/msg/String")
    plain = Graph(0, "a1b2")
    assert plain.node_token() == "@ros2_lv/0/a1b2/0/0/NN/%/%/rover_bridge"
    assert plain.topic_token(4, chatter, published=True) == (
        f"@ros2_lv/0/a1b2/0/4/MP/%/%/rover_bridge/%chatter/std_msgs::msg::dds_::String_/{STRING}/::,10:,:,:,,"
    )
    named = Graph(7, "a1b2", "lab/bot1")
    latched = Topic("lab/bot1/chatter", "std_msgs/msg/String", latched=True)
    assert named.node_token() == "@ros2_lv/7/a1b2/0/0/NN/%/%lab%bot1/rover_bridge"
    assert named.topic_token(1, latched, published=True) == (
        "@ros2_lv/7/a1b2/0/1/MP/%/%lab%bot1/rover_bridge/%lab%bot1%chatter/std_msgs::msg::dds_::String_/"
        f"{STRING}/:1:,1:,:,:,,"
    )
    assert named.topic_token(2, chatter, published=False).split("/")[5] == "MS"


def test_a_publishers_gid_is_the_hash_of_its_token_low_half_first():
    # xxHash's published test vector: XXH128 of nothing is 99aa06d3014798d8 6001c324468d497f.
    assert gid("") == struct.pack("<QQ", 0x6001C324468D497F, 0x99AA06D3014798D8)


def test_attachments_are_what_zenohs_own_serializer_makes():
    ours = Attachment(258, 0x1718_1920_2122_2324, bytes(range(16)))
    theirs = zenoh.ext.z_serialize((zenoh.ext.Int64(258), zenoh.ext.Int64(ours.stamp_ns), ours.gid))
    assert ours.pack() == theirs.to_bytes()
    assert ours.pack().hex() == "0201000000000000" + "2423222120191817" + "10" + bytes(range(16)).hex()
    assert Attachment.unpack(ours.pack()) == ours


# Addresses of robots and their topics


def test_addresses():
    assert parse_ros_address("ros2/tcp/robot") == RosAddress("tcp/robot:7447")
    found = parse_ros_address("ros2/tcp/[::1]:8000#rmw=zenoh&domain=7&namespace=/a200_0001")
    assert (found.endpoint, found.domain, found.namespace) == ("tcp/[::1]:8000", 7, "a200_0001")
    assert (found.convention, found.hashed) == ("rmw-zenoh", True)
    assert not parse_ros_address("ros2/tcp/robot#rmw=zenoh&distro=humble").hashed


@pytest.mark.parametrize(
    "text",
    [
        *("ros2/", "ros2/udp/x", "ros2/tcp/x:0", "ros2/tcp/x#rmw=dds"),
        *("ros2/tcp/x#domain=233", "ros2/tcp/x#odom=o"),
    ],
)
def test_bad_addresses_are_refused(text):
    with pytest.raises(UsageError, match="expected ros2/tcp/HOST"):
        parse_ros_address(text)
