"""Poses of a ROS 2 robot's own localiser, sent to a bridge: AMCL's, a PoseStamped, or transforms."""

import contextlib
import time
from collections import Counter

import numpy as np
import zenoh

from deploy.drive.link import Arrival, Inbox
from deploy.drive.measurements import pose_reader
from deploy.tag.ros_source import RosSource
from deploy.zenoh_client import BridgeAddress, ZenohClient, matches, with_covariance
from rover_ncp.core.config import ResultModel
from rover_ncp.core.console import Output
from rover_ncp.core.errors import FormatError
from rover_ncp.core.geometry import ORIGIN, Pose, compose
from rover_ncp.core.interruption import INTERRUPTED
from rover_ncp.core.process import Interrupts
from rover_ncp.wire.cdr import decode, encode
from rover_ncp.wire.key_table import KEYS, TAG_VIEW, spec
from rover_ncp.wire.messages import BASE_FRAME, TF, pose_with_covariance, read_yaw

BASE_FRAMES = BASE_FRAME, "base_footprint"
"""Names of the base, whose pose in the plane is the same."""
TAKE_S = 0.1


class PoseLink(ZenohClient):
    """A session with a bridge that sends poses and pictures, and receives nothing."""

    def __init__(self, address: BridgeAddress) -> None:
        super().__init__(address, lambda row, data: None, own=[row.name for row in KEYS])

    def _declare(self) -> None:
        self._publisher = self._session.declare_publisher(self.key("pose"))
        # A picture never delays a pose, nor anything else on the way.
        self._viewed = self._session.declare_publisher(
            self.key(TAG_VIEW),
            congestion_control=zenoh.CongestionControl.DROP,
            priority=zenoh.Priority.BACKGROUND,
        )

    def send(self, pose: bytes) -> None:
        """Send a pose with the moment of its measurement."""
        self._publisher.put(pose)

    @property
    def watched(self) -> bool:
        """Whether a page receives pictures."""
        return matches(self._viewed)

    def show(self, jpeg: bytes) -> None:
        """Send a picture for people; one that is too large for `watch` is left out."""
        row = spec(TAG_VIEW)
        data = encode(row.type, format="jpeg", data=np.frombuffer(jpeg, np.uint8))
        if len(data) <= row.max_bytes:
            self._viewed.put(data)


class RelayResult(ResultModel):
    """Result of ``tag relay``."""

    poses: int
    """poses that were sent"""
    rejected: dict[str, int]
    """messages that gave no pose, by reason"""
    seconds: float
    """duration"""


class TransformPoses:
    """Poses of the base in ``frame``, one for each transform of that frame: as often as a localiser corrects.

    AMCL dates its transform ahead, so the moment is that of the transform of the base.
    """

    def __init__(self, frame: str) -> None:
        self._frame = frame
        self._links: dict[str, tuple[str, Pose, int]] = {}
        """Parent, newest pose in it and its stamp (ns) of each frame."""

    def take(self, data: bytes) -> bytes | None:
        """Return the pose after a TFMessage as a PoseWithCovarianceStamped of unknown variance.

        None if the message has no transform of the frame. Raises FormatError for a message that cannot be
        read, and if no transforms lead from the frame to the base.
        """
        corrected = False
        for each in decode(TF, data).transforms:
            parent, shift, stamp = (
                each.header.frame_id.lstrip("/"),
                each.transform.translation,
                each.header.stamp,
            )
            pose = Pose(shift.x, shift.y, read_yaw(each.transform.rotation))
            self._links[each.child_frame_id.lstrip("/")] = parent, pose, stamp.sec * 10**9 + stamp.nanosec
            corrected |= parent == self._frame
        if not corrected and any(parent == self._frame for parent, _, _ in self._links.values()):
            return None
        for base in BASE_FRAMES:
            pose, frame, links = ORIGIN, base, dict(self._links)
            while frame in links:
                frame, step, _ = links.pop(frame)
                pose = compose(step, pose)
                if frame == self._frame:
                    return pose_with_covariance(pose, np.zeros((3, 3)), self._links[base][2], frame)
        known = ", ".join(f"{parent} → {child}" for child, (parent, _, _) in self._links.items())
        raise FormatError(f"no transforms from {self._frame!r} to {BASE_FRAME!r}, only {known or 'none'}")


def relay(source: str, *, address: BridgeAddress, frame: str, seconds: float | None, output: Output) -> int:
    """See ``commands.relay``; return the exit code."""
    where, inbox, reasons, poses = RosSource.parse(source, "topic", "amcl_pose"), Inbox(), Counter[str](), 0
    transforms = TransformPoses(frame) if where.topic.rpartition("/")[2] == "tf" else None
    read = pose_reader(frame)

    def receive(sample: zenoh.Sample) -> None:
        inbox.put(Arrival(sample.payload.to_bytes(), time.monotonic_ns()))

    with Interrupts() as interrupts, PoseLink(address) as link, contextlib.closing(where.open()) as session:
        held = session.declare_subscriber(where.key(where.topic), receive)
        output.announce(f"relaying {where.topic}")
        began = time.monotonic()
        while not interrupts.raised and (seconds is None or time.monotonic() - began < seconds):
            for arrival in inbox.take(TAKE_S):
                try:
                    take = with_covariance if transforms is None else transforms.take
                    pose = take(arrival.data)
                    if pose is not None:
                        read(pose)
                        link.send(pose)
                        poses += 1
                except FormatError as error:
                    if not reasons[str(error)]:
                        output.say(f"no pose of a message on '{where.topic}': {error}")
                    reasons[str(error)] += 1
        del held
        result = RelayResult(poses=poses, rejected=dict(reasons), seconds=time.monotonic() - began)
    words = "" if poses or reasons else f"; no message arrived on '{where.topic}'"
    output.result(result.model_dump(), f"{poses} poses sent{words}")
    return INTERRUPTED if interrupts.raised else 0 if poses else 1
