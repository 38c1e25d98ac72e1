"""The Zenoh session with a ROS 2 robot: a client of its router, in the form of either Zenoh integration.

It has nothing in common with the drivers' session: both have keys named ``odom`` and ``cmd_vel``. A token on
the robot's side, which the drivers' side must not see, shows whether the two networks are connected.
"""

import secrets
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import zenoh

from bridge.inbox import Inbox, RobotMessage
from bridge.ros2.address import RosAddress, command_type, sensor_topics
from bridge.ros2.base import TokenSeen
from bridge.ros2.discovery import Announced, Convention, bridge_token, read_topic_token, topic_token
from bridge.ros2.rmw import Attachment, Graph, Topic, gid, read_token
from bridge.ros2.ros_node import publisher
from rover_ncp.core.errors import FormatError, NoRobot
from rover_ncp.robot.description import Topics
from rover_ncp.wire.messages import TWIST, TWIST_STAMPED
from rover_ncp.wire.zenoh import client_config, reason

LOOP_KEY = "rover/robot_side"
MAX_BYTES = 1 << 16
"""Longer messages are cut off and count as unreadable."""


class RosConnection:
    """Opens at once: raises NoRobot when no router answers. ``inbox`` gets messages and tokens."""

    def __init__(self, address: RosAddress, topics: Topics, inbox: Inbox) -> None:
        self.endpoint, self._address, self._inbox = address.endpoint, address, inbox
        self.bytes_in = self.bytes_out = self._sequence = 0
        self.source: bytes | None = None
        self._session = _open(address.endpoint, address.zenoh_config)
        self.zid = str(self._session.info.zid())
        self.nonce = secrets.token_hex(8)
        self._held: list[Any] = []
        inputs, taken = sensor_topics(topics), command_type(topics)
        if address.convention is Convention.RMW_ZENOH:
            self._join_graph(inputs, topics.cmd_vel, taken)
        else:
            self._use_plain_keys(inputs, topics.cmd_vel, taken)
        self._held.append(self._session.liveliness().declare_token(f"{LOOP_KEY}/{self.nonce}"))

    def topic(self, name: str) -> str:
        """Return a topic with the namespace."""
        return self._address.topic(name)

    def publish(self, payload: bytes) -> None:
        """Send a command; it is dropped if it cannot leave at once."""
        self.bytes_out += len(payload)
        self._sequence += 1
        if self.source is None:
            self._publisher.put(payload)
        else:
            attachment = Attachment(self._sequence, time.time_ns(), self.source)
            self._publisher.put(payload, attachment=attachment.pack())

    def wait(self, seconds: float) -> None:
        """Let time pass."""
        time.sleep(seconds)

    def close(self) -> None:
        """End the session; its tokens go with it."""
        session: Any = self._session
        session.close()

    def _use_plain_keys(self, inputs: list[tuple[str, str]], cmd_vel: str, ros_type: str) -> None:
        tokens = [bridge_token(self.zid)]
        for name, kind in inputs:
            self._subscribe(self.topic(name), name)
            tokens.append(topic_token(self.zid, self.topic(name), kind, published=False, reliable=False))
        self._publisher: Any = publisher(self._session, self.topic(cmd_vel), latched=False)
        tokens.append(topic_token(self.zid, self.topic(cmd_vel), ros_type, published=True))
        self._subscribe(self.topic(cmd_vel), cmd_vel)
        self._watch_tokens("@/*/@ros2_lv/**", read_topic_token)
        self._declare(tokens)

    def _join_graph(self, inputs: list[tuple[str, str]], cmd_vel: str, ros_type: str) -> None:
        domain = self._address.domain
        graph = Graph(domain, self.zid, self._address.namespace)
        tokens = [graph.node_token()]
        for name, kind in inputs:
            topic = Topic(self.topic(name), kind, hashed=self._address.hashed)
            self._subscribe(topic.key(domain), name)
            tokens.append(graph.subscriber_token(len(tokens), topic))
        topic = Topic(self.topic(cmd_vel), ros_type, hashed=self._address.hashed)
        token = graph.publisher_token(len(tokens), topic)
        tokens.append(token)
        self.source = gid(token)
        self._publisher = publisher(self._session, topic.key(domain), latched=False)
        for kind in (TWIST, TWIST_STAMPED):
            taken = Topic(self.topic(cmd_vel), kind, hashed=self._address.hashed)
            self._subscribe(taken.key(domain), cmd_vel)
        self._watch_tokens(f"@ros2_lv/{domain}/**", read_token)
        self._declare(tokens)

    def _declare(self, tokens: list[str]) -> None:
        liveliness = self._session.liveliness()
        self._held += [liveliness.declare_token(token) for token in tokens]

    def _subscribe(self, key: str, name: str) -> None:
        def receive(sample: zenoh.Sample) -> None:
            payload = sample.payload.to_bytes()[:MAX_BYTES]
            self.bytes_in += len(payload)
            self._inbox.put(RobotMessage(name, payload, time.monotonic(), _source(sample)))

        # Our own commands come back only from outside, and then through a loop.
        subscriber = self._session.declare_subscriber(
            key, self._inbox.guarded(receive), allowed_origin=zenoh.Locality.REMOTE
        )
        self._held.append(subscriber)

    def _watch_tokens(self, pattern: str, read: Callable[[str], Announced | None]) -> None:
        def receive(sample: zenoh.Sample) -> None:
            if (found := read(str(sample.key_expr))) is not None:
                self._inbox.put(TokenSeen(found, sample.kind == zenoh.SampleKind.PUT))

        liveliness = self._session.liveliness()
        self._held.append(liveliness.declare_subscriber(pattern, self._inbox.guarded(receive), history=True))


def _source(sample: zenoh.Sample) -> bytes | None:
    """Return the publisher's identity in rmw_zenoh's attachment; None without one."""
    if sample.attachment is None:
        return None
    try:
        return Attachment.unpack(sample.attachment.to_bytes()).gid
    except FormatError:
        return None


def _open(endpoint: str, file: Path | None) -> zenoh.Session:
    config, _ = client_config(endpoint, file)
    try:
        return zenoh.open(config)
    except zenoh.ZError as error:
        raise NoRobot(
            f"{endpoint}: no Zenoh router answers there: {reason(error)}; start zenoh-bridge-ros2dds or "
            "rmw_zenohd on the robot"
        ) from error
