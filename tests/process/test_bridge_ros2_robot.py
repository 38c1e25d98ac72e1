"""The bridge and a ROS 2 robot on real Zenoh, in the form of either integration.

The robot is the mock, or a network of plain Zenoh.
"""

import socket
import struct
import threading
import time
from contextlib import closing, contextmanager, suppress

import pytest
from kit.bridge_bench import Driver, wait_for
from kit.described import described
from kit.ros2_world import BURGER, odometry
from kit.zenoh_session import open_router

from bridge.inbox import Inbox, RobotMessage
from bridge.ros2.address import parse_ros_address
from bridge.ros2.base import command
from bridge.ros2.connection import RosConnection
from bridge.ros2.discovery import Convention
from bridge.ros2.ros_node import RosNode
from rover_ncp.core.errors import NoRobot
from rover_ncp.core.geometry import Velocity
from rover_ncp.core.process import ClosedAtExit
from rover_ncp.wire.cdr import decode, encode
from rover_ncp.wire.messages import BOOL, read_twist
from rover_ncp.wire.zenoh import CLIENT
from sim.park.live import RMW_ZENOH, ROS2DDS, LiveRun, Process

# Published in each message package of ROS 2 Jazzy (REP-2011).
ODOMETRY_HASH = "RIHS01_3cc97dc7fb7502f8714462c526d369e35b603cfc34d946e3f2eda2766dfec6e0"
STAMPED_HASH = "RIHS01_5f0fcd4f81d5d06ad9b4c4c63e3ea51b82d6ae4d0558f1d475229b1121db6f64"


MODEL = ["--model", "turtlebot3-burger"]
FORMS = pytest.mark.parametrize("form", [ROS2DDS, RMW_ZENOH], ids=["ros2dds", "rmw-zenoh"])


def mock_of(form):
    return ["--ros2", *MODEL, "--ros", "rmw-zenoh" if form == RMW_ZENOH else "ros2dds"]


def robot(folder, form):
    return LiveRun(folder, mock=mock_of(form), bridge=[*MODEL, "--no-base-watchdog"], base_form=form)


def test_the_robot_is_driven_and_odometry_begins_at_zero(tmp_path):
    with robot(tmp_path, RMW_ZENOH) as rig, Driver(rig.robot) as driver:
        wait_for(lambda: driver.odom is not None)
        assert max(map(abs, driver.odom.pose)) < 0.01
        driver.start(v=0.1)
        wait_for(lambda: {"imu", "battery_state"} <= set(driver.seen))


@contextmanager
def connected(base, topics=BURGER.topics):
    """The bridge's connection with a robot, and what arrived of each topic and of tokens."""
    inbox, messages, tokens = Inbox(), {}, []
    with closing(RosConnection(parse_ros_address(base), topics, inbox)) as connection:

        def look():
            for _, arrival in inbox.take(0.02):
                if isinstance(arrival, RobotMessage):
                    messages[arrival.topic] = arrival
                else:
                    tokens.append(arrival.token)
            return messages, tokens

        yield connection, look


class RobotNetwork(ClosedAtExit):
    """The Zenoh network of a robot that this process is: odometry, and all commands that arrive."""

    def __init__(self, form, *connect):
        self.form, self.commands, self.tokens = form, [], {}
        retry = {"connect/retry": {"period_init_ms": 50, "period_max_ms": 50}}
        self.session, locator = open_router(**{"connect/endpoints": list(connect)}, **retry)
        self.base = form.format(locator.removeprefix("tcp/"))
        rmw = form == RMW_ZENOH
        # As rmw_zenoh's design has them: domain, topic, type and the hash of the type's definition.
        self.odom_key = f"0/odom/nav_msgs::msg::dds_::Odometry_/{ODOMETRY_HASH}" if rmw else "odom"
        self.cmd_key = (
            f"0/cmd_vel/geometry_msgs::msg::dds_::TwistStamped_/{STAMPED_HASH}" if rmw else "cmd_vel"
        )
        self._held = [
            self.session.declare_subscriber(self.cmd_key, self.commands.append),
            *(
                self.session.liveliness().declare_subscriber(key, self._token, history=True)
                for key in ("**", "@/*/@ros2_lv/**", "@ros2_lv/**")
            ),
        ]
        self._sent, self._closing = 0, threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _token(self, sample):
        self.tokens[str(sample.key_expr)] = sample.kind

    def _run(self):
        while not self._closing.wait(0.05):
            self._sent += 1
            attachment = struct.pack("<qqB16s", self._sent, time.time_ns(), 16, b"r" * 16)
            rmw = self.form == RMW_ZENOH
            self.session.put(self.odom_key, odometry(time.time()), attachment=attachment if rmw else None)

    def close(self):
        self._closing.set()
        self._thread.join()
        self.session.close()


@FORMS
def test_what_goes_over_the_wire_is_in_the_published_form(form):
    with RobotNetwork(form) as network, connected(network.base) as (connection, look):
        for _ in range(2):
            connection.publish(command(BURGER.topics, Velocity(0.1, 0.0), time.time_ns()))
        wait_for(lambda: len(network.commands) == 2 and "odom" in look()[0])
        assert read_twist(network.commands[0].payload.to_bytes()).velocity == Velocity(0.1, 0.0)
        wait_for(lambda: len(network.tokens) > 5)
        tokens = [token.split("/") for token in network.tokens]
        if form == ROS2DDS:
            assert all(sample.attachment is None for sample in network.commands)
            shown = {tuple(token[3:]) for token in tokens if token[0] == "@" and len(token) > 3}
            assert ("MP", "cmd_vel", "geometry_msgs§msg§TwistStamped", ":1:0:0,10") in shown
            assert ("MS", "odom", "nav_msgs§msg§Odometry", ":0:0:0,10") in shown  # best effort
        else:
            # 33 bytes: sequence number, time in ns, the length 16, the publisher's 16 bytes.
            unpacked = [struct.unpack("<qqB16s", s.attachment.to_bytes()) for s in network.commands]
            assert [number for number, *_ in unpacked] == [1, 2]
            assert {(length, gid) for _, _, length, gid in unpacked} == {(16, connection.source)}
            shown = {(token[5], token[8], *token[9:12]) for token in tokens if len(token) == 13}
            cmd_vel = ("%cmd_vel", "geometry_msgs::msg::dds_::TwistStamped_", STAMPED_HASH)
            assert ("MP", "rover_bridge", *cmd_vel) in shown
            assert look()[0]["odom"].source == b"r" * 16


@FORMS
def test_a_latched_stop_that_was_pressed_before_the_bridge_came_arrives(form):
    topics = described(BURGER.name, topics={"stop": {"topic": "stop", "latched": True}}).topics
    with RobotNetwork(form) as network:
        convention = Convention.RMW_ZENOH if form == RMW_ZENOH else Convention.ROS2DDS
        node = RosNode(network.session, convention, name="estop")
        button = node.publisher("stop", BOOL, latched=True)
        button.put(encode(BOOL, data=True))
        node.announce()
        with connected(network.base, topics) as (_, look):
            wait_for(lambda: "stop" in look()[0])
            assert decode(BOOL, look()[0]["stop"].payload).data
            wait_for(lambda: any(token.topic == "stop" and token.published for token in look()[1]))


# What a router of Zenoh 0.11 answered to the first message of a session, of its own version and of another.
OLD_ACK = bytes.fromhex("450021 08f0ffa64d3520 2680ca5124ccdfc2688b")
CLOSED = bytes.fromhex("02000302")


def test_a_router_of_another_version_is_named(monkeypatch):
    monkeypatch.setitem(CLIENT, "connect/timeout_ms", 100)
    with socket.create_server(("127.0.0.1", 0)) as server:

        def serve():
            with suppress(OSError):
                while True:
                    line, _ = server.accept()
                    with line:
                        data = line.recv(64)
                        if len(data) > 3:
                            line.sendall(OLD_ACK if data[3] == 8 else CLOSED)

        threading.Thread(target=serve, daemon=True).start()
        base = f"ros2/tcp/127.0.0.1:{server.getsockname()[1]}"
        with pytest.raises(NoRobot, match="a Zenoh before version 1 listens there"):
            RosConnection(parse_ros_address(base), BURGER.topics, Inbox())
        server.shutdown(socket.SHUT_RDWR)


@pytest.mark.long
def test_nobody_drives_a_robot_until_its_description_has_the_measured_timeout(tmp_path):
    bridge = ["--model", "husky-a200"]
    mock = ["--ros2", "--model", "husky-a200"]
    with LiveRun(tmp_path / "run", mock=mock, bridge=bridge, base_form=ROS2DDS) as rig:
        with Driver(rig.robot) as driver:
            reply = driver.motors()
            assert (reply.granted, reply.reason) == (False, "unchecked")
            assert "--measure-timeout" in reply.detail
        rig.bridge.stop()
        arguments = ["--base", ROS2DDS.format(rig.base), *bridge, "--measure-timeout"]
        with Process("bridge", arguments, tmp_path) as measuring:
            done = measuring.wait(60.0)
        assert done.code == 0, done
        # The mock halts 0.5 s after its last command, as its description has it.
        assert 0.45 <= done.result["timeout_s"] <= 0.9
    mine = tmp_path / "mine.yaml"
    mine.write_text(f"name: mine\nbased_on: husky-a200\n{done.result['line']}\n")
    with (
        LiveRun(tmp_path / "mine", mock=mock, bridge=["--model", str(mine)], base_form=ROS2DDS) as rig,
        Driver(rig.robot) as driver,
    ):
        assert driver.motors().granted
