"""Poses of a ROS 2 robot's own localiser, sent to a bridge: AMCL's, a PoseStamped, or transforms."""

import contextlib
import math
import time
from collections import Counter

import numpy as np
import zenoh
from pydantic import BaseModel, Field

from deploy.drive.link import Arrival, Inbox
from deploy.drive.measurements import pose_reader
from deploy.tag.pose_link import PoseLink
from deploy.tag.ros_source import Frames, RosSource
from deploy.zenoh_client import BridgeAddress, with_covariance
from rover_ncp.core.console import Output
from rover_ncp.core.errors import FormatError, UsageError
from rover_ncp.core.geometry import Pose
from rover_ncp.core.interruption import INTERRUPTED
from rover_ncp.core.process import Interrupts
from rover_ncp.wire.messages import BASE_FRAME, pose_with_covariance

FOOTPRINT = "base_footprint"
"""Another name of the base, whose pose in the plane is the same."""
TAKE_S = 0.1


class RelayResult(BaseModel):
    """Result of ``tag relay``."""

    poses: int = Field(description="poses that were sent")
    rejected: dict[str, int] = Field(description="messages that gave no pose, by reason")
    seconds: float = Field(description="duration")


class TransformPoses:
    """Poses of the base in ``frame``, one for each transform of that frame: as often as a localiser corrects.

    AMCL dates its transform ahead, so the moment is that of the transform of the base. Raises UsageError for
    a frame of the base itself.
    """

    def __init__(self, frame: str) -> None:
        if frame in {BASE_FRAME, FOOTPRINT}:
            raise UsageError(f"--frame {frame}: that is the base; give the frame of the poses, such as map")
        self._frame, self._frames = frame, Frames()

    def take(self, data: bytes) -> bytes | None:
        """Return the pose after a TFMessage as a PoseWithCovarianceStamped of unknown variance.

        None if the message has no transform of the frame. Raises FormatError for a message that cannot be
        read, and if no transforms lead from the frame to the base.
        """
        frame, corrected, links = self._frame, self._frames.take(data), self._frames.links
        if frame not in corrected and any(parent == frame for parent, _, _ in links.values()):
            return None
        try:
            base, found = BASE_FRAME, self._frames.pose(frame, BASE_FRAME)
        except FormatError:
            if FOOTPRINT not in links:
                raise
            base, found = FOOTPRINT, self._frames.pose(frame, FOOTPRINT)
        pose = Pose(float(found[0, 3]), float(found[1, 3]), math.atan2(found[1, 0], found[0, 0]))
        return pose_with_covariance(pose, np.zeros((3, 3)), links[base][2], frame)


def relay(source: str, *, address: BridgeAddress, frame: str, seconds: float | None, output: Output) -> int:
    """See ``commands.relay``; return the exit code."""
    where, inbox, reasons, poses = (
        RosSource.parse(source, "topic", "amcl_pose"),
        Inbox[Arrival](),
        Counter[str](),
        0,
    )
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
    output.result(result, f"{poses} poses sent{words}")
    return INTERRUPTED if interrupts.raised else 0 if poses else 1
