"""The Zenoh session with a ROS 2 robot: a client of its router, in the form of either Zenoh integration.

It has nothing in common with the drivers' session: both have keys named ``odom`` and ``cmd_vel``. A token on
the robot's side, which the drivers' side must not see, shows whether the two networks are connected.
"""

import secrets
import time
from collections.abc import Callable
from typing import Any

import zenoh

from bridge.inbox import Inbox, RobotMessage
from bridge.ros2.address import RosAddress, command_type, hazard_topics, sensor_topics
from bridge.ros2.discovery import Announced, Convention, TokenSeen, read_topic_token
from bridge.ros2.rmw import Attachment, read_token
from bridge.ros2.ros_node import RosNode
from rover_ncp.core.errors import FormatError
from rover_ncp.robot.topics import Topics
from rover_ncp.wire.messages import TWIST, TWIST_STAMPED
from rover_ncp.wire.zenoh import open_robot

LOOP_KEY = "rover/robot_side"
MAX_BYTES = 1 << 16
"""Longer messages are cut off and count as unreadable."""


class RosConnection:
    """Opens at once: raises NoRobot when no router answers. ``inbox`` gets messages and tokens."""

    def __init__(self, address: RosAddress, topics: Topics, inbox: Inbox) -> None:
        self.endpoint, self._inbox = address.endpoint, inbox
        self._session = open_robot(address.endpoint, address.zenoh_config)
        self.zid = str(self._session.info.zid())
        self.nonce = secrets.token_hex(8)
        rmw, taken = address.convention is Convention.RMW_ZENOH, command_type(topics)
        node = self._node = RosNode(
            self._session,
            address.convention,
            domain=address.domain,
            namespace=address.namespace,
            hashed=address.hashed,
        )
        for name, ros_type in sensor_topics(topics):
            node.subscribe(name, ros_type, self._receiver(name), reliable=False)
        for found, ros_type in hazard_topics(topics):
            receive = self._receiver(found.topic)
            node.subscribe(found.topic, ros_type, receive, reliable=found.latched, latched=found.latched)
        self._commands = node.publisher(topics.cmd_vel, taken)
        self.source = self._commands.source
        for ros_type in (TWIST, TWIST_STAMPED) if rmw else (taken,):
            node.subscribe(topics.cmd_vel, ros_type, self._receiver(topics.cmd_vel), announced=False)
        if rmw:
            tokens = self._watch_tokens(f"@ros2_lv/{address.domain}/**", read_token)
        else:
            tokens = self._watch_tokens("@/*/@ros2_lv/**", read_topic_token)
        node.announce()
        self._held = [tokens, self._session.liveliness().declare_token(f"{LOOP_KEY}/{self.nonce}")]

    def topic(self, name: str) -> str:
        """Return a topic with the namespace."""
        return self._node.topic(name)

    def publish(self, payload: bytes) -> None:
        """Send a command; it is dropped if it cannot leave at once."""
        self._commands.put(payload)

    def wait(self, seconds: float) -> None:
        """Let time pass."""
        time.sleep(seconds)

    def close(self) -> None:
        """End the session; its tokens go with it."""
        self._node.close()
        session: Any = self._session
        session.close()

    def _receiver(self, name: str) -> Callable[[zenoh.Sample], None]:
        def receive(sample: zenoh.Sample) -> None:
            payload = sample.payload.to_bytes()[:MAX_BYTES]
            self._inbox.put(RobotMessage(name, payload, time.monotonic(), _source(sample)))

        return self._inbox.guarded(receive)

    def _watch_tokens(self, pattern: str, read: Callable[[str], Announced | None]) -> Any:
        def receive(sample: zenoh.Sample) -> None:
            if (found := read(str(sample.key_expr))) is not None:
                self._inbox.put(TokenSeen(found, sample.kind == zenoh.SampleKind.PUT))

        liveliness = self._session.liveliness()
        return liveliness.declare_subscriber(pattern, self._inbox.guarded(receive), history=True)


def _source(sample: zenoh.Sample) -> bytes | None:
    """Return the publisher's identity in rmw_zenoh's attachment; None without one."""
    if sample.attachment is None:
        return None
    try:
        return Attachment.unpack(sample.attachment.to_bytes()).gid
    except FormatError:
        return None
