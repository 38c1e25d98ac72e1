"""The bridge as a node of rmw_zenoh's graph, on the Zenoh session of its link."""

import contextlib
import time
from collections.abc import Callable, Iterable
from typing import Any

import zenoh
import zenoh.ext

from bridge.inbox import CommandMessage
from bridge.ros2.rmw import Attachment, Graph, Topic, gid
from rover_ncp.core.errors import FormatError
from rover_ncp.wire.key_table import KeySpec, key, spec
from rover_ncp.wire.messages import TWIST, TWIST_STAMPED

HEARTBEAT_S = 0.5
"""Period of heartbeats, which give a publisher's last sequence number after a change; as in rmw_zenoh."""


def publisher(session: zenoh.Session, key_expr: str, latched: bool) -> Any:
    """Declare a publisher that never waits. Late subscribers receive a ``latched`` one's last message."""
    if not latched:
        return session.declare_publisher(
            key_expr,
            encoding=zenoh.Encoding.APPLICATION_CDR,
            congestion_control=zenoh.CongestionControl.DROP,
        )
    return zenoh.ext.declare_advanced_publisher(
        session,
        key_expr,
        encoding=zenoh.Encoding.APPLICATION_CDR,
        congestion_control=zenoh.CongestionControl.DROP,
        cache=zenoh.ext.CacheConfig(max_samples=1),
        sample_miss_detection=zenoh.ext.MissDetectionConfig(heartbeat=None, sporadic_heartbeat=HEARTBEAT_S),
        publisher_detection=True,
    )


class RmwNode:
    """Publishers of ``rows`` and subscribers of ``cmd_vel``; ``commanded`` gets the received commands.

    Raises UsageError for a namespace that ROS does not accept.
    """

    def __init__(
        self,
        session: zenoh.Session,
        domain: int,
        namespace: str,
        rows: Iterable[KeySpec],
        commanded: Callable[[zenoh.Sample], None],
    ) -> None:
        self._session = session
        self._graph = Graph(domain, str(session.info.zid()), namespace.strip("/"))
        self._tokens = [self._graph.node_token()]
        self._publishers: dict[str, _Publisher] = {}
        for row in rows:
            topic = Topic(key(namespace, row.name), row.type, row.latched)
            token = self._graph.publisher_token(len(self._tokens), topic)
            self._tokens.append(token)
            self._publishers[row.name] = _Publisher(session, topic.key(domain), topic.latched, gid(token))
        self._held: list[Any] = []
        for ros_type in (TWIST, TWIST_STAMPED):
            topic = Topic(key(namespace, "cmd_vel"), ros_type)
            self._tokens.append(self._graph.subscriber_token(len(self._tokens), topic))
            self._held.append(session.declare_subscriber(topic.key(domain), commanded))

    def announce(self) -> None:
        """Show the node, its publishers and its subscribers in the graph."""
        tokens = self._session.liveliness()
        self._held += [tokens.declare_token(token) for token in self._tokens]

    def publish(self, name: str, data: bytes) -> None:
        """Send a message on a key of the table."""
        self._publishers[name].put(data)


class _Publisher:
    """A publisher that numbers and stamps what it sends."""

    def __init__(self, session: zenoh.Session, key_expr: str, latched: bool, gid_: bytes) -> None:
        self._gid, self._sequence = gid_, 0
        self._publisher: Any = publisher(session, key_expr, latched)

    def put(self, data: bytes) -> None:
        self._sequence += 1
        self._publisher.put(data, attachment=Attachment(self._sequence, time.time_ns(), self._gid).pack())


def command_bytes(sample: zenoh.Sample) -> bytes:
    """Return the payload of a command; of one that is too long, one byte too many, which makes it invalid.

    The loop so digests no megabytes, and its queue holds none.
    """
    return sample.payload.to_bytes()[: spec("cmd_vel").max_bytes + 1]


def read_command(sample: zenoh.Sample) -> CommandMessage:
    """Return a ROS node's command: without a tag, sent at the time in its attachment.

    Without a valid attachment it is not a message of rmw_zenoh, and becomes an unreadable command.
    """
    attachment = sample.attachment
    with contextlib.suppress(FormatError):
        if attachment is not None:
            stamp_ns = Attachment.unpack(attachment.to_bytes()).stamp_ns
            return CommandMessage(command_bytes(sample), None, stamp_ns)
    return CommandMessage(b"")
