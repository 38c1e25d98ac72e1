"""rmw_zenoh's form: tokens, keys, attachments by hand; ROS nodes made of plain Zenoh on a real bridge."""

import struct
import time
from contextlib import contextmanager

import pytest
import zenoh
import zenoh.ext
from kit.bridge_bench import MACHINE_S, PERIOD_S, Driver, Rig, braking_s, client, wait_for
from kit.zenoh_session import open_session

from bridge.inbox import CommandMessage, Inbox
from bridge.ros2.discovery import Convention
from bridge.ros2.rmw import Attachment, Graph, Topic, domain_id, gid, read_token
from bridge.zenoh.link import ZenohLink
from rover_ncp.core.errors import FormatError, UsageError
from rover_ncp.core.process import ClosedAtExit
from rover_ncp.wire.key_table import KEYS, Kind, Role, spec
from rover_ncp.wire.messages import Transform, decode, transforms

# Type hashes as ROS 2 Jazzy's own packages carry them.
STRING = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"
TWIST = "RIHS01_9c45bf16fe0983d80e3cfe750d6835843d265a9a6c46bd2e609fcddde6fb8d2a"
ODOMETRY = "RIHS01_3cc97dc7fb7502f8714462c526d369e35b603cfc34d946e3f2eda2766dfec6e0"
TWIST_KEY = f"5/bot1/cmd_vel/geometry_msgs::msg::dds_::Twist_/{TWIST}"
STOP_S = 0.5


def test_a_topics_key_has_domain_name_type_and_hash():
    chatter = Topic("chatter", "std_msgs/msg/String")
    assert chatter.key(0) == f"0/chatter/std_msgs::msg::dds_::String_/{STRING}"
    odom = Topic("bot1/odom", "nav_msgs/msg/Odometry")
    assert odom.key(42) == f"42/bot1/odom/nav_msgs::msg::dds_::Odometry_/{ODOMETRY}"


def test_tokens_have_the_form_that_ros_nodes_read():
    chatter = Topic("chatter", "std_msgs/msg/String")
    plain = Graph(0, "a1b2")
    assert plain.node_token() == "@ros2_lv/0/a1b2/0/0/NN/%/%/rover_bridge"
    assert plain.publisher_token(4, chatter) == (
        f"@ros2_lv/0/a1b2/0/4/MP/%/%/rover_bridge/%chatter/std_msgs::msg::dds_::String_/{STRING}/::,10:,:,:,,"
    )
    named = Graph(7, "a1b2", "lab/bot1")
    latched = Topic("lab/bot1/chatter", "std_msgs/msg/String", latched=True)
    assert named.node_token() == "@ros2_lv/7/a1b2/0/0/NN/%/%lab%bot1/rover_bridge"
    assert named.publisher_token(1, latched) == (
        "@ros2_lv/7/a1b2/0/1/MP/%/%lab%bot1/rover_bridge/%lab%bot1%chatter/std_msgs::msg::dds_::String_/"
        f"{STRING}/:1:,1:,:,:,,"
    )
    assert named.subscriber_token(2, chatter).split("/")[5] == "MS"


@pytest.mark.parametrize("ros_type", ["Twist", ""])
def test_a_token_with_a_type_of_no_package_announces_nothing(ros_type):
    token = Graph(0, "a1b2").publisher_token(1, Topic("cmd_vel", "geometry_msgs/msg/Twist"))
    assert read_token(token) is not None
    assert read_token(token.replace("geometry_msgs::msg::dds_::Twist_", ros_type)) is None


@pytest.mark.parametrize("namespace", ["bot-1", "1bot", "lab//bot", "lab/", "böt"])
def test_namespace_that_ros_does_not_accept_is_rejected(namespace):
    with pytest.raises(UsageError, match="for ROS"):
        Graph(0, "a1b2", namespace)


def test_a_publishers_gid_is_the_hash_of_its_token_low_half_first():
    # xxHash's published test vector: XXH128 of nothing is 99aa06d3014798d8 6001c324468d497f.
    assert gid("") == struct.pack("<QQ", 0x6001C324468D497F, 0x99AA06D3014798D8)


def test_attachments_are_what_zenohs_own_serializer_makes():
    ours = Attachment(258, 0x1718_1920_2122_2324, bytes(range(16)))
    theirs = zenoh.ext.z_serialize((zenoh.ext.Int64(258), zenoh.ext.Int64(ours.stamp_ns), ours.gid))
    assert ours.pack() == theirs.to_bytes()
    assert ours.pack().hex() == "0201000000000000" + "2423222120191817" + "10" + bytes(range(16)).hex()
    assert Attachment.unpack(ours.pack()) == ours


@pytest.mark.parametrize("data", [b"", bytes(32), bytes(33), bytes(34), b"\x10" * 34])
def test_invalid_attachment_is_rejected(data):
    with pytest.raises(FormatError, match="not an attachment"):
        Attachment.unpack(data)


@pytest.mark.parametrize(
    ("environment", "expected"), [({}, 0), ({"ROS_DOMAIN_ID": ""}, 0), ({"ROS_DOMAIN_ID": "232"}, 232)]
)
def test_domain_is_ros_domain_id(environment, expected):
    assert domain_id(environment) == expected


@pytest.mark.parametrize("value", ["233", "-1", "one", "1.5", "²"])
def test_invalid_domain_is_rejected(value):
    with pytest.raises(UsageError, match=f"ROS_DOMAIN_ID={value}"):
        domain_id({"ROS_DOMAIN_ID": value})


class Link5(ClosedAtExit):
    """A link in domain 5, without a robot, and a client of it."""

    def __init__(self, *conventions):
        self.inbox = Inbox()
        self.link = ZenohLink("tcp/127.0.0.1:0", "bot1", None, self.inbox, ros=conventions)
        self.link.announce()
        self.session = client(self.link.locator)

    def tokens(self, pattern):
        return [str(reply.ok.key_expr) for reply in self.session.liveliness().get(pattern, timeout=2.0)]

    def close(self):
        self.session.close()
        self.link.close()


@pytest.fixture
def domain_5(monkeypatch):
    monkeypatch.setenv("ROS_DOMAIN_ID", "5")


@pytest.mark.parametrize(
    ("conventions", "dds", "rmw"),
    [
        ([Convention.ROS2DDS], True, False),
        ([Convention.RMW_ZENOH], False, True),
        (list(Convention), True, True),
    ],
)
def test_tokens_follow_the_chosen_conventions(domain_5, conventions, dds, rmw):
    with Link5(*conventions) as bridge:
        assert bool(bridge.tokens("@/*/@ros2_lv/**")) is dds
        assert bool(bridge.tokens("@ros2_lv/**")) is rmw


def test_the_graph_shows_the_node_and_all_its_topics(domain_5):
    with Link5(Convention.RMW_ZENOH) as bridge:
        chunks = [token.split("/") for token in bridge.tokens("@ros2_lv/5/**")]
    assert {chunk[2] for chunk in chunks} == {chunks[0][2]}  # one session
    assert len({chunk[4] for chunk in chunks}) == len(chunks)  # each of its own number
    assert {tuple(chunk[6:9]) for chunk in chunks} == {("%", "%bot1", "rover_bridge")}
    shown = {(chunk[5], chunk[9], chunk[10]) for chunk in chunks if chunk[5] != "NN"}
    ours = [row for row in KEYS if row.kind is Kind.MESSAGE and row.senders == {Role.BRIDGE}]
    twists = {
        ("MS", "%bot1%cmd_vel", f"geometry_msgs::msg::dds_::{name}_") for name in ("Twist", "TwistStamped")
    }
    assert shown == twists | {
        (
            "MP",
            f"%bot1%{row.name.replace('/', '%')}",
            f"{row.type.split('/')[0]}::msg::dds_::{row.type.split('/')[2]}_",
        )
        for row in ours
    }


@contextmanager
def late_joiner(session, key):
    """A subscriber of a transient local topic, as both rmw_zenoh and zenoh-bridge-ros2dds declare it."""
    got = []
    history = zenoh.ext.HistoryConfig(detect_late_publishers=True, max_samples=1)
    subscriber = zenoh.ext.declare_advanced_subscriber(session, key, got.append, history=history)
    try:
        yield got
    finally:
        subscriber.undeclare()


def test_late_subscribers_receive_static_transforms(domain_5):
    data = transforms([Transform("base_link", "sonar_0", 0.1, 0.2, 0.0, 0.5)], 1)
    with Link5(Convention.RMW_ZENOH) as bridge:
        bridge.link.publish("tf_static", data)
        token = next(token for token in bridge.tokens("@ros2_lv/5/**") if "%tf_static/" in token)
        rmw_key = "/".join(["5/bot1/tf_static", *token.split("/")[10:12]])
        for key in ("bot1/tf_static", rmw_key):
            with late_joiner(bridge.session, key) as got:
                wait_for(lambda: got)
            assert got[0].payload.to_bytes() == data
    assert Attachment.unpack(got[0].attachment.to_bytes())[::2] == (1, gid(token))


def test_age_of_a_ros_nodes_command_is_in_its_attachment(domain_5):
    twist = b"\0\1\0\0" + struct.pack("<6d", 0.15, 0, 0, 0, 0, 0)
    tag = Attachment(1, 123_456_789, bytes(16)).pack()
    with Link5(Convention.RMW_ZENOH) as bridge:
        publisher = bridge.session.declare_publisher(TWIST_KEY)
        wait_for(lambda: publisher.matching_status.matching)
        for attachment in (tag, None, b"x" * 32):
            publisher.put(twist, attachment=attachment)
        arrived = []
        wait_for(lambda: arrived.extend(bridge.inbox.take(0.1)) or len(arrived) >= 3)
    # What rmw_zenoh would not take is a command that cannot be read: a tag of ours buys nothing here.
    unreadable = CommandMessage(b"", None, None)
    assert [what for _, what in arrived] == [CommandMessage(twist, None, 123_456_789), unreadable, unreadable]


def test_ros_nodes_find_each_other_through_the_bridge(domain_5):
    with Link5(Convention.RMW_ZENOH) as bridge:
        peers = [ros_node(bridge.link.locator) for _ in range(2)]
        try:
            heard = []
            held = peers[0].declare_subscriber("5/chatter/x/y", heard.append)
            wait_for(lambda: peers[1].put("5/chatter/x/y", b"hi") or heard)
            held.undeclare()
        finally:
            for peer in peers:
                peer.close()


def ros_node(locator):
    """A session with the settings that rmw_zenoh gives its nodes: peers that look for a router."""
    settings = {
        "connect/endpoints": [locator],
        "listen/endpoints": ["tcp/127.0.0.1:0"],
        "scouting/gossip/enabled": True,
        "scouting/gossip/target": {"router": ["router", "peer"], "peer": ["router"]},
        "scouting/gossip/autoconnect": {"router": [], "peer": ["router", "peer"]},
        "timestamping/enabled": True,
    }
    return open_session("peer", settings)


class RosDriver(ClosedAtExit):
    """A ROS node that publishes Twist on cmd_vel and listens to odom."""

    def __init__(self, locator):
        self.session, self.sequence, self.odom = ros_node(locator), 0, []
        self._commands = self.session.declare_publisher(TWIST_KEY)
        odom_key = f"5/bot1/odom/nav_msgs::msg::dds_::Odometry_/{ODOMETRY}"
        self._held = self.session.declare_subscriber(odom_key, self.odom.append)
        wait_for(lambda: self._commands.matching_status.matching)

    def send(self, v, age_s=0.0):
        """Send one command; return the wall clock's ns."""
        self.sequence += 1
        sent_ns = time.time_ns()
        attachment = Attachment(self.sequence, sent_ns - round(age_s * 1e9), bytes(16)).pack()
        self._commands.put(b"\0\1\0\0" + struct.pack("<6d", v, 0, 0, 0, 0, 0), attachment=attachment)
        return sent_ns

    @property
    def speed(self):
        """The speed of the last odometry message, at its place in the bytes."""
        return struct.unpack_from("<d", self.odom[-1].payload.to_bytes(), 388)[0] if self.odom else 0.0

    def close(self):
        self.session.close()


def test_a_ros_node_drives_while_its_commands_are_fresh(domain_5, tmp_path):
    options = ["--ros", "rmw-zenoh", "--accept-ros", "--namespace", "/bot1"]
    with Rig(tmp_path, bridge=options) as rig, RosDriver(rig.locator) as ros:
        with Driver(rig.locator, "bot1") as watching:
            deadline = time.monotonic() + 5.0
            while ros.speed < 0.14:
                assert time.monotonic() < deadline
                sent_ns = ros.send(0.15)
                time.sleep(PERIOD_S)
            assert watching.gate.driver_name == "ros"
            for _ in range(10):
                ros.send(0.15, age_s=0.5)
                time.sleep(PERIOD_S)
            assert rig.stood_after(sent_ns) < STOP_S + braking_s(0.15) + MACHINE_S
            wait_for(lambda: watching.gate.dropped.get("stale") == 10)
        sequences = [Attachment.unpack(sample.attachment.to_bytes()).sequence for sample in ros.odom]
        assert sequences == list(range(sequences[0], sequences[0] + len(sequences)))
        message = decode(spec("odom").type, ros.odom[-1].payload.to_bytes())
        assert (message.header.frame_id, message.child_frame_id) == ("odom", "base_link")


def test_ros_nodes_do_not_drive_unless_they_are_accepted(domain_5, tmp_path):
    options = ["--ros", "rmw-zenoh", "--namespace", "bot1"]
    with (
        Rig(tmp_path, bridge=options) as rig,
        RosDriver(rig.locator) as ros,
        Driver(rig.locator, "bot1") as watching,
    ):
        began_ns = time.time_ns()
        for _ in range(10):
            ros.send(0.15)
        wait_for(lambda: watching.gate.dropped == {"foreign": 10})
        assert rig.stood_after(began_ns) == 0.0
