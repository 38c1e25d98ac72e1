"""A topic of a ROS 2 robot on its Zenoh router, in the form of either Zenoh integration.

Keys are plain topics (zenoh-bridge-ros2dds), or those of rmw_zenoh: domain, topic, type and hash.
"""

from typing import NamedTuple, Self

import zenoh

from rover_ncp.core.errors import NoRobot, UsageError
from rover_ncp.wire.address import parse_ros_endpoint
from rover_ncp.wire.zenoh import PORT, client_config, reason


class RosSource(NamedTuple):
    """A topic with its namespace; ``domain`` is that of rmw_zenoh, None for plain keys."""

    endpoint: str
    topic: str
    namespace: str
    domain: int | None

    @classmethod
    def parse(cls, source: str, name: str, topic: str) -> Self:
        """Read an address as that of ``bridge --base``, with ``name`` for the topic. Raises UsageError."""
        where = parse_ros_endpoint(source, PORT)
        settings = {} if where is None else dict(where.settings)
        topic = settings.pop(name, topic).strip("/")
        if where is None or settings or not topic:
            raise UsageError(
                f"{source}: expected ros2/tcp/HOST[:PORT][#{name}=TOPIC&namespace=NAME], with "
                "&rmw=zenoh&domain=N for rmw_zenoh"
            )
        namespace = where.namespace
        topic = f"{namespace}/{topic}" if namespace else topic
        return cls(where.endpoint, topic, namespace, where.domain if where.rmw_zenoh else None)

    def key(self, topic: str) -> str:
        """Return the key expression of a topic of this robot, whatever its type."""
        return topic if self.domain is None else f"{self.domain}/{topic}/*/*"

    def open(self) -> zenoh.Session:
        """Open a session with the router. Raises NoRobot."""
        config, _ = client_config(self.endpoint, None)
        try:
            return zenoh.open(config)
        except zenoh.ZError as error:
            raise NoRobot(f"{self.endpoint}: no Zenoh router answers there: {reason(error)}") from error
