"""Topics in a recording for viewers alone: the course's frame, the pose, the path, each neuron by name.

Foxglove, Lichtblick and Rerun draw transforms, poses, paths and single numbers. They know neither a course's
frame nor the neuron of an array element. These topics are neither sent over the wire nor read back.
"""

import struct
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from rover_ncp.core.geometry import Pose, compose, inverse
from rover_ncp.core.messages import (
    ODOM_FRAME,
    Transform,
    neurons,
    path,
    pose_stamped,
    transforms,
)
from rover_ncp.core.recording import Recorded

FRAMES_TOPIC = "deploy/frames"
POSE_TOPIC = "deploy/pose"
PATH_TOPIC = "deploy/path"
NEURON_TOPICS = "neurons/"
_VALUE = struct.Struct("<d")


class Views:
    """The messages of one drive, as it goes on."""

    def __init__(self, record: Callable[[Recorded], None], names: Sequence[str], frame: str) -> None:
        self._record, self._frame = record, frame
        # An array of one, as that is what all of them draw; its value is its last eight bytes.
        self._neurons = [(NEURON_TOPICS + name, neurons([0.0], [name])[: -_VALUE.size]) for name in names]
        self._began_ns = 0
        self._way: list[Pose] = []

    def start(self, wall_ns: int, pose: Pose, odometry: Pose) -> None:
        """Begin at ``pose`` in the course, where odometry stands at ``odometry``."""
        self._began_ns = wall_ns
        where = compose(pose, inverse(odometry))
        odom = Transform(self._frame, ODOM_FRAME, where.x, where.y, 0.0, where.theta)
        self._put(FRAMES_TOPIC, "tf2_msgs/msg/TFMessage", transforms([odom], wall_ns), wall_ns)

    def tick(self, wall_ns: int, pose: Pose, potentials: NDArray[np.float64] | None) -> None:
        """Note where the rover is, and its neurons if they were asked."""
        self._way.append(pose)
        data = pose_stamped(pose, wall_ns, self._frame)
        self._put(POSE_TOPIC, "geometry_msgs/msg/PoseStamped", data, wall_ns)
        if potentials is not None:
            for (topic, before), potential in zip(self._neurons, potentials.tolist(), strict=True):
                self._put(topic, "std_msgs/msg/Float64MultiArray", before + _VALUE.pack(potential), wall_ns)

    def finish(self) -> None:
        """Leave the whole path, dated at the start, so that it is there from the first moment of a replay."""
        if self._way:
            data = path(self._way, self._began_ns, self._frame)
            self._put(PATH_TOPIC, "nav_msgs/msg/Path", data, self._began_ns)

    def _put(self, topic: str, ros_type: str, data: bytes, wall_ns: int) -> None:
        self._record(Recorded(topic, ros_type, data, wall_ns, wall_ns))
