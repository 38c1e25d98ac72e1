"""The Zenoh side of a mock ROS 2 robot: a router with the robot's topics in the form of either integration.

Keys, attachments and tokens are those that zenoh-bridge-ros2dds and rmw_zenoh use (`bridge.ros`).
"""

import json
import queue
import selectors
import socket
import time
from contextlib import suppress
from typing import Any

import zenoh

from bridge.ros2.address import command_type, sensor_topics
from bridge.ros2.discovery import Convention, bridge_token, topic_token
from bridge.ros2.rmw import Attachment, Graph, Topic, gid
from bridge.ros2.ros_node import publisher
from rover_ncp.core.errors import PortInUse
from rover_ncp.wire.zenoh import reason
from sim.pioneer.real_time import RealTimeLoop
from sim.pioneer.ros2_robot import Ros2Robot

_SETTINGS: dict[str, Any] = {
    "mode": "router",
    "scouting/delay": 0,
    "scouting/multicast/enabled": False,
    "scouting/gossip/enabled": False,
    "transport/link/tx/lease": 1000,
}


class Ros2Server(RealTimeLoop):
    """Serves a robot on Zenoh. Raises PortInUse."""

    def __init__(
        self,
        host: str,
        port: int,
        robot: Ros2Robot,
        *,
        convention: Convention = Convention.ROS2DDS,
        domain: int = 0,
        namespace: str = "",
    ) -> None:
        super().__init__(robot)
        self.host, self.port, self.robot = host, port or free_port(host), robot
        self.bytes_in = self.bytes_out = 0
        self._namespace, self._domain = namespace.strip("/"), domain
        self._session = _open(host, self.port)
        self._commands: queue.SimpleQueue[bytes] = queue.SimpleQueue()
        self._arrived, self._woken = socket.socketpair()
        self._arrived.setblocking(False)
        # As a robot does, the mock takes a command when it arrives, not when its next step is due.
        self.selector.register(self._woken, selectors.EVENT_READ, lambda: self._woken.recv(4096))
        self._publishers: dict[str, Any] = {}
        self._numbers: dict[str, tuple[bytes, int]] = {}
        self._held: list[Any] = []
        topics = robot.topics
        outputs, taken = sensor_topics(topics), command_type(topics)
        declare = self._plain if convention is Convention.ROS2DDS else self._graph
        tokens = declare(outputs, topics.cmd_vel, taken)
        self._held += [self._session.liveliness().declare_token(token) for token in tokens]

    def send(self) -> None:
        """Take the commands that arrived, and publish what the robot has to say."""
        while not self._commands.empty():
            self.robot.command(self._commands.get(), time.monotonic())
        for name, payload in self.robot.messages():
            self.bytes_out += len(payload)
            if name not in self._numbers:
                self._publishers[name].put(payload)
                continue
            source, number = self._numbers[name]
            self._numbers[name] = source, number + 1
            attachment = Attachment(number + 1, time.time_ns(), source)
            self._publishers[name].put(payload, attachment=attachment.pack())

    def close(self) -> None:
        """End the session and close the truth."""
        session: Any = self._session
        session.close()
        super().close()
        self._arrived.close()
        self._woken.close()

    def _topic(self, name: str) -> str:
        return f"{self._namespace}/{name}" if self._namespace else name

    def _plain(self, outputs: list[tuple[str, str]], cmd_vel: str, taken: str) -> list[str]:
        zid = str(self._session.info.zid())
        for name, _ in outputs:
            self._publishers[name] = publisher(self._session, self._topic(name), latched=False)
        self._subscribe(self._topic(cmd_vel))
        shown = [topic_token(zid, self._topic(name), ros_type, published=True) for name, ros_type in outputs]
        return [bridge_token(zid), *shown, topic_token(zid, self._topic(cmd_vel), taken, published=False)]

    def _graph(self, outputs: list[tuple[str, str]], cmd_vel: str, taken: str) -> list[str]:
        node = self.robot.description.name.replace("-", "_")
        graph = Graph(self._domain, str(self._session.info.zid()), self._namespace, node)
        tokens = [graph.node_token()]
        for name, ros_type in outputs:
            topic = Topic(self._topic(name), ros_type)
            tokens.append(graph.publisher_token(len(tokens), topic))
            self._numbers[name] = gid(tokens[-1]), 0
            self._publishers[name] = publisher(self._session, topic.key(self._domain), latched=False)
        topic = Topic(self._topic(cmd_vel), taken)
        self._subscribe(topic.key(self._domain))
        return [*tokens, graph.subscriber_token(len(tokens), topic)]

    def _subscribe(self, key: str) -> None:
        def receive(sample: zenoh.Sample) -> None:
            payload = sample.payload.to_bytes()
            self.bytes_in += len(payload)
            self._commands.put(payload)
            with suppress(BlockingIOError):  # full: the mock will wake
                self._arrived.send(b"\0")

        self._held.append(self._session.declare_subscriber(key, receive))


def free_port(host: str) -> int:
    """Return a TCP port that nothing listens on now."""
    with socket.socket() as probe:
        probe.bind((host, 0))
        return int(probe.getsockname()[1])


def _open(host: str, port: int) -> zenoh.Session:
    config = zenoh.Config()
    for path, value in {**_SETTINGS, "listen/endpoints": [f"tcp/{host}:{port}"]}.items():
        config.insert_json5(path, json.dumps(value))
    try:
        return zenoh.open(config)
    except zenoh.ZError as error:
        raise PortInUse(f"--listen {host}:{port}: cannot listen there: {reason(error)}") from error
