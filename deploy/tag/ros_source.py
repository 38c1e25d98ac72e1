"""A topic of a ROS 2 robot on its Zenoh router, in the form of either Zenoh integration, and its frames.

Keys are plain topics (zenoh-bridge-ros2dds), or those of rmw_zenoh: domain, topic, type and hash.
"""

from typing import NamedTuple, Self

import numpy as np
import zenoh
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from rover_ncp.core.errors import FormatError, UsageError
from rover_ncp.core.geometry import same_frame
from rover_ncp.wire.address import parse_ros_endpoint
from rover_ncp.wire.cdr import decode
from rover_ncp.wire.messages import TF
from rover_ncp.wire.pose_fields import read_yaw
from rover_ncp.wire.zenoh import PORT, open_robot


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
        if where is None or settings or "" in topic.split("/"):
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
        return open_robot(self.endpoint)


class Frames:
    """The frames of a robot by its transforms so far."""

    def __init__(self) -> None:
        self._links: dict[str, tuple[str, NDArray[np.float64]]] = {}
        """Of each frame its parent, and its newest pose there (4 × 4)."""

    def take(self, data: bytes) -> None:
        """Take a TFMessage. Raises FormatError."""
        for each in decode(TF, data).transforms:
            shift, turn, pose = each.transform.translation, each.transform.rotation, np.eye(4)
            read_yaw(turn)  # raises FormatError for what is no rotation
            pose[:3, :3] = Rotation.from_quat([turn.x, turn.y, turn.z, turn.w]).as_matrix()
            pose[:3, 3] = shift.x, shift.y, shift.z
            if not np.isfinite(pose).all():
                raise FormatError(f"the transform to {each.child_frame_id!r} is not finite")
            self._links[each.child_frame_id.lstrip("/")] = each.header.frame_id.lstrip("/"), pose

    def pose(self, ancestor: str, frame: str) -> NDArray[np.float64]:
        """Return the pose (4 × 4) of a frame in one above it, which may have a robot's prefix.

        Raises FormatError if no transforms lead there.
        """
        pose, at, links = np.eye(4), frame.lstrip("/"), dict(self._links)
        while not (at and same_frame(at, ancestor)) and at in links:
            at, step = links.pop(at)
            pose = step @ pose
        if at and same_frame(at, ancestor):
            return pose
        known = ", ".join(f"{parent} → {child}" for child, (parent, _) in self._links.items())
        raise FormatError(f"no transforms from {ancestor!r} to {frame!r}, only {known or 'none'}")
