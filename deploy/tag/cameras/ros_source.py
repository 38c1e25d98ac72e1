"""A topic of images of a ROS 2 robot, in the form of either Zenoh integration, and the robot's frames.

Keys are plain topics (zenoh-bridge-ros2dds), or those of rmw_zenoh: domain, topic, type and hash.
"""

from collections.abc import Iterable
from typing import NamedTuple, Self

import numpy as np
import zenoh
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from rover_ncp.core.errors import FormatError, UsageError
from rover_ncp.core.geometry import same_frame
from rover_ncp.wire.address import parse_ros_endpoint
from rover_ncp.wire.cdr import decode
from rover_ncp.wire.message_parts import read_yaw
from rover_ncp.wire.messages import TF
from rover_ncp.wire.zenoh import PORT, open_robot

IMAGE_TOPIC = "camera/image_raw"


class RosSource(NamedTuple):
    """A topic with its namespace; ``domain`` is that of rmw_zenoh, None for plain keys."""

    endpoint: str
    topic: str
    namespace: str
    domain: int | None

    @classmethod
    def parse(cls, source: str) -> Self:
        """Read an address as that of ``bridge --base``, with ``image`` for the topic. Raises UsageError."""
        where = parse_ros_endpoint(source, PORT)
        settings = {} if where is None else dict(where.settings)
        topic = settings.pop("image", IMAGE_TOPIC).strip("/")
        if where is None or settings or "" in topic.split("/"):
            raise UsageError(
                f"{source}: expected ros2/tcp/HOST[:PORT][#image=TOPIC&namespace=NAME], with "
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


def frame_pose(messages: Iterable[bytes], ancestor: str, frame: str) -> NDArray[np.float64]:
    """Return the pose (4 × 4) of a frame in one above it, which may have a robot's prefix.

    ``messages`` are TFMessages; later transforms replace earlier ones of the same frame. Raises FormatError
    if they are none, or lead to no ancestor.
    """
    links: dict[str, tuple[str, NDArray[np.float64]]] = {}
    for each in (each for data in messages for each in decode(TF, data).transforms):
        shift, turn, step = each.transform.translation, each.transform.rotation, np.eye(4)
        read_yaw(turn)  # raises FormatError for what is no rotation
        step[:3, :3] = Rotation.from_quat([turn.x, turn.y, turn.z, turn.w]).as_matrix()
        step[:3, 3] = shift.x, shift.y, shift.z
        if not np.isfinite(step).all():
            raise FormatError(f"the transform to {each.child_frame_id!r} is not finite")
        links[each.child_frame_id.lstrip("/")] = each.header.frame_id.lstrip("/"), step
    known = ", ".join(f"{parent} → {child}" for child, (parent, _) in links.items())
    pose, at = np.eye(4), frame.lstrip("/")
    while not (at and same_frame(at, ancestor)):
        if at not in links:
            raise FormatError(f"no transforms from {ancestor!r} to {frame!r}, only {known or 'none'}")
        at, step = links.pop(at)
        pose = step @ pose
    return pose
