"""A node of a ROS graph on a Zenoh session, in the form of either Zenoh integration."""

import time
from collections.abc import Callable
from typing import Any

import zenoh
import zenoh.ext

from bridge.ros2.discovery import Convention, bridge_token, topic_token
from bridge.ros2.rmw import NODE_NAME, Attachment, Graph, Topic, gid

HEARTBEAT_S = 0.5
"""Period of heartbeats, which give a publisher's last sequence number after a change; as in rmw_zenoh."""


def declare_publisher(session: zenoh.Session, key_expr: str, latched: bool = False) -> Any:
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


class RosPublisher:
    """Publishes on one key. In rmw_zenoh's form it numbers and stamps messages, and ``source`` is its gid."""

    def __init__(self, session: zenoh.Session, key_expr: str, latched: bool, source: bytes | None) -> None:
        self.source, self._sequence = source, 0
        self._publisher: Any = declare_publisher(session, key_expr, latched)

    def put(self, data: bytes) -> None:
        """Send a message; it is dropped if it cannot leave at once."""
        if self.source is None:
            self._publisher.put(data)
            return
        self._sequence += 1
        attachment = Attachment(self._sequence, time.time_ns(), self.source)
        self._publisher.put(data, attachment=attachment.pack())


class RosNode:
    """Publishers and subscribers of topics below ``namespace``.

    Keys of rmw_zenoh have type hashes if they are ``hashed``. Raises UsageError for a namespace that ROS does
    not accept.
    """

    def __init__(
        self,
        session: zenoh.Session,
        convention: Convention,
        *,
        domain: int = 0,
        namespace: str = "",
        name: str = NODE_NAME,
        hashed: bool = True,
    ) -> None:
        self._session, self._zid = session, str(session.info.zid())
        self._domain, self._namespace, self._hashed = domain, namespace.strip("/"), hashed
        self._graph: Graph | None = None
        if convention is Convention.RMW_ZENOH:
            self._graph = Graph(domain, self._zid, self._namespace, name)
        self._tokens = [self._graph.node_token() if self._graph else bridge_token(self._zid)]
        self._held: list[Any] = []
        self._latched: list[Any] = []
        """Subscribers of latched topics."""

    def topic(self, name: str) -> str:
        """Return a topic with the namespace, without a leading slash."""
        return f"{self._namespace}/{name}" if self._namespace else name

    def publisher(self, name: str, ros_type: str, latched: bool = False) -> RosPublisher:
        """Return a publisher of a topic."""
        topic = self._topic(name, ros_type, latched)
        self._tokens.append(token := self._token(topic, published=True))
        source = gid(token) if self._graph else None
        return RosPublisher(self._session, self._key(topic), latched, source)

    def subscribe(
        self,
        name: str,
        ros_type: str,
        receive: Callable[[zenoh.Sample], None],
        *,
        announced: bool = True,
        reliable: bool = True,
        latched: bool = False,
    ) -> None:
        """Call ``receive`` with each message of a topic from outside this session.

        Of a ``latched`` one also with the last message of each publisher, which may have sent it long ago.
        """
        topic = self._topic(name, ros_type, latched)
        if announced:
            self._tokens.append(self._token(topic, published=False, reliable=reliable))
        if latched:
            history = zenoh.ext.HistoryConfig(detect_late_publishers=True, max_samples=1)
            late = zenoh.ext.declare_advanced_subscriber(
                self._session, self._key(topic), receive, history=history
            )
            self._latched.append(late)
            return
        # Messages of our own come back only from outside, and then through a loop.
        subscriber = self._session.declare_subscriber(
            self._key(topic), receive, allowed_origin=zenoh.Locality.REMOTE
        )
        self._held.append(subscriber)

    def announce(self) -> None:
        """Show the node, its publishers and its subscribers to others."""
        tokens = self._session.liveliness()
        self._held += [tokens.declare_token(token) for token in self._tokens]

    def close(self) -> None:
        """End the subscriptions of latched topics: with one of them, Zenoh hangs when it closes a session."""
        while self._latched:
            self._latched.pop().undeclare()

    def _topic(self, name: str, ros_type: str, latched: bool = False) -> Topic:
        return Topic(self.topic(name), ros_type, latched, self._hashed)

    def _key(self, topic: Topic) -> str:
        return topic.key(self._domain) if self._graph else topic.name

    def _token(self, topic: Topic, *, published: bool, reliable: bool = True) -> str:
        if self._graph is None:
            return topic_token(
                self._zid, topic.name, topic.ros_type, published, topic.latched, reliable=reliable
            )
        return self._graph.topic_token(len(self._tokens), topic, published=published)
