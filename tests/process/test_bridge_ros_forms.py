"""The bridge's topics in the forms of both Zenoh integrations; ROS nodes made of plain Zenoh."""

import signal
import struct
import time
from contextlib import contextmanager

import pytest
import zenoh.ext
from kit.bridge_bench import PERIOD_S, Driver, client, wait_for
from kit.zenoh_session import open_session

from bridge.inbox import Inbox
from bridge.ros2.discovery import Convention
from bridge.ros2.rmw import Attachment, gid
from bridge.zenoh.link import ZenohLink
from rover_ncp.core.process import ClosedAtExit
from rover_ncp.wire.key_table import KEYS, Kind, Role
from rover_ncp.wire.messages import Transform, transforms
from sim.park.live import LiveRun, Process

# Type hashes as ROS 2 Jazzy's own packages carry them.
TWIST = "RIHS01_9c45bf16fe0983d80e3cfe750d6835843d265a9a6c46bd2e609fcddde6fb8d2a"
TWIST_KEY = f"5/bot1/cmd_vel/geometry_msgs::msg::dds_::Twist_/{TWIST}"
OURS = [row for row in KEYS if row.kind is Kind.MESSAGE and row.senders == {Role.BRIDGE}]


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


def test_every_topic_of_a_bridge_shows_itself_to_ros2dds_and_cmd_vel_has_no_type(domain_5):
    """With a token of TwistStamped, zenoh-bridge-ros2dds would pass on no Twist."""
    with Link5(Convention.ROS2DDS) as bridge:
        found = {token.split("@ros2_lv", 1)[1] for token in bridge.tokens("@/*/@ros2_lv/**")}
        assert not bridge.tokens("@ros2_lv/**")
    assert "" in found
    topics = [token.split("/")[1:3] for token in found if token]
    shown = {(kind, key.replace("§", "/")) for kind, key in topics}
    assert shown == {("MP", f"bot1/{row.name}") for row in OURS}


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


def test_a_huge_command_reaches_the_loop_as_no_more_than_one_that_is_too_long(domain_5):
    with Link5(Convention.ROS2DDS) as bridge:
        # A driver's own settings would drop what cannot leave at once.
        with open_session("client", {"connect/endpoints": [bridge.link.locator]}) as peer:
            publisher = peer.declare_publisher("bot1/cmd_vel")
            wait_for(lambda: publisher.matching_status.matching)
            publisher.put(bytes(400_000), attachment=bytes(400_000))
            (_, arrival), *_ = wait_for(lambda: bridge.inbox.take(0.1))
        assert (len(arrival.payload), len(arrival.attachment)) == (513, 41)


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
    """A ROS node that publishes Twist on cmd_vel in either form of the two integrations."""

    def __init__(self, locator, key):
        self.session = ros_node(locator)
        self._commands = self.session.declare_publisher(key)
        wait_for(lambda: self._commands.matching_status.matching)

    def send(self, v):
        self._commands.put(b"\0\1\0\0" + struct.pack("<6d", v, 0, 0, 0, 0, 0))

    def close(self):
        self.session.close()


def test_ros_nodes_drive_through_teleop_one_after_the_other(domain_5, tmp_path):
    limits = tmp_path / "limits.yaml"
    limits.write_text("v_max: 0.1\n")
    options = ["--ros", "rmw-zenoh", "--namespace", "/bot1", "--limits", str(limits)]
    with LiveRun(tmp_path, bridge=options) as rig, Driver(rig.robot, "bot1") as watching:
        arguments = ["--robot", rig.robot, "--namespace", "bot1", "--topic", "cmd_vel"]
        teleop = rig.start_process(lambda: Process("teleop", arguments, tmp_path))
        teleop.wait_for_line("passes on")
        for key in (TWIST_KEY, "bot1/cmd_vel"):
            with RosDriver(rig.robot, key) as ros:

                def drives(ros=ros):
                    ros.send(0.15 if watching.gate.lease else 0.0)  # it begins with a zero
                    time.sleep(PERIOD_S)
                    return watching.odom and watching.odom.velocity.v >= 0.09 and watching.out.v == 0.1

                wait_for(drives)
                assert watching.gate.driver_name == "teleop"
                assert watching.motors().reason == "another-driver"
            wait_for(lambda: watching.gate.lease == 0)
            assert watching.gate.ended == ""  # teleop released it
        # A stall of this computer makes odometry late: then the next request counts.
        reply = wait_for(lambda: (found := watching.motors()).reason != "odometry" and found)
        assert reply.granted
        teleop.send_signal(signal.SIGTERM)
        assert teleop.wait(10.0).code == 130
        rig.bridge.send_signal(signal.SIGHUP)
        done = rig.bridge.wait(5.0)
    assert done.code == 0
    assert set(done.result["limited"]) == {"speed"}
