"""The Zenoh side of a mock ROS 2 robot: a router with its topics, in the form of either integration."""

import json
import queue
import selectors
import socket
import time
from contextlib import suppress
from typing import Any

import zenoh

from bridge.ros2.address import command_type, hazard_topics, sensor_topics
from bridge.ros2.discovery import Convention
from bridge.ros2.ros_node import RosNode
from rover_ncp.core.errors import PortInUse
from rover_ncp.wire.zenoh import reason
from sim.base.ros2_robot import Ros2Robot
from sim.mock.real_time import RealTimeLoop

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
        self._session = _open(host, self.port)
        self._commands: queue.SimpleQueue[bytes] = queue.SimpleQueue()
        self._arrived, self._woken = socket.socketpair()
        self._arrived.setblocking(False)
        # As a robot does, the mock takes a command when it arrives, not when its next step is due.
        self.selector.register(self._woken, selectors.EVENT_READ, lambda: self._woken.recv(4096))
        topics, name = robot.topics, robot.robot.name.replace("-", "_")
        self._node = RosNode(self._session, convention, domain=domain, namespace=namespace, name=name)
        self._publishers = {
            name: self._node.publisher(name, ros_type) for name, ros_type in sensor_topics(topics)
        } | {
            found.topic: self._node.publisher(found.topic, ros_type, found.latched)
            for found, ros_type in hazard_topics(topics)
        }
        self._node.subscribe(topics.cmd_vel, command_type(topics), self._receive)
        self._node.announce()

    def send(self) -> None:
        """Take the commands that arrived, and publish what the robot has to say."""
        while not self._commands.empty():
            self.heard_s = time.monotonic()
            self.robot.command(self._commands.get(), self.heard_s)
        for name, payload in self.robot.messages():
            self._publishers[name].put(payload)

    def close(self) -> None:
        """End the session and close the truth."""
        session: Any = self._session
        session.close()
        super().close()
        self._arrived.close()
        self._woken.close()

    def _receive(self, sample: zenoh.Sample) -> None:
        self._commands.put(sample.payload.to_bytes())
        with suppress(BlockingIOError):  # full: the mock will wake
            self._arrived.send(b"\0")


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
