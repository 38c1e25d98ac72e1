"""Messages that a drive publishes and records for each tick. Nothing here decides anything.

Foxglove, Lichtblick and Rerun draw transforms, poses, paths and single numbers. Viewers show neither the
drive's frame nor which neuron an array element is. So the recording also holds topics for viewers alone: the
frame, the pose, the path, each neuron by name. These topics are recorded only: nothing sends them over the
wire or reads them back.
"""

import struct
import time
from collections.abc import Callable, Sequence

from deploy.drive.controller import Tick
from deploy.drive.link import Link
from deploy.drive.records import START_TOPIC, TICKS_TOPIC, StartRecord, TickRecord
from deploy.estimator.estimator import Estimate
from deploy.place.outcome import DOCK_TOPIC, DockResult
from rover_ncp.core.geometry import Pose, compose, inverse
from rover_ncp.core.process import Clock
from rover_ncp.recording.recording import Recorded
from rover_ncp.wire.messages import (
    COURSE_FRAME,
    ODOM_FRAME,
    Transform,
    neurons,
    path,
    pose_stamped,
    pose_with_covariance,
    text,
    transforms,
)
from rover_ncp.wire.protocol import DriverStatus, dump_json

FRAMES_TOPIC = "deploy/frames"
POSE_TOPIC = "deploy/pose"
PATH_TOPIC = "deploy/path"
NEURON_TOPIC_PREFIX = "neurons/"
_VALUE = struct.Struct("<d")


def estimate_message(estimate: Estimate, wall_ns: int, frame: str) -> bytes:
    """Return the estimate's pose with its 3 × 3 covariance as it goes over the wire."""
    return pose_with_covariance(estimate.pose, estimate.covariance[:3, :3], wall_ns, frame)


class Publisher:
    """Publishes and records one drive, whose poses are in ``frame``: the course's or its place's."""

    def __init__(
        self,
        link: Link,
        record: Callable[[Recorded], None],
        neuron_names: Sequence[str],
        clock: Clock = time,
        *,
        frame: str = COURSE_FRAME,
    ) -> None:
        self._link, self._record, self._names, self._clock = link, record, neuron_names, clock
        self._frame = frame
        # An array of one element, which all viewers draw. Encoded once with a zero; each tick replaces the
        # last eight bytes (float64).
        self._neurons = [
            (NEURON_TOPIC_PREFIX + name, neurons([0.0], [name])[: -_VALUE.size]) for name in neuron_names
        ]
        self._began_ns = 0
        self._path: list[Pose] = []

    def start(self, record: StartRecord, odometry: Pose) -> None:
        """Record the start; ``odometry`` is the odometry pose at it."""
        self._began_ns = wall_ns = self._clock.time_ns()
        self._record_json(START_TOPIC, dump_json(record), wall_ns)
        odom = compose(Pose(*record.pose), inverse(odometry))
        transform = Transform(self._frame, ODOM_FRAME, odom.x, odom.y, 0.0, odom.theta)
        self._view(FRAMES_TOPIC, "tf2_msgs/msg/TFMessage", transforms([transform], wall_ns), wall_ns)

    def tick(self, record: TickRecord, estimate: Estimate, tick: Tick | None) -> None:
        """Record the tick and the pose; publish the estimate, and the potentials if the circuit ran."""
        wall_ns = record.wall_ns
        self._record_json(TICKS_TOPIC, dump_json(record), wall_ns)
        self._link.publish("rover/estimate", estimate_message(estimate, wall_ns, self._frame), wall_ns)
        if tick is not None:
            self._link.publish("rover/neurons", neurons(tick.potentials, self._names), wall_ns)
        self._path.append(estimate.pose)
        data = pose_stamped(estimate.pose, wall_ns, self._frame)
        self._view(POSE_TOPIC, "geometry_msgs/msg/PoseStamped", data, wall_ns)
        if tick is not None:
            for (topic, prefix), potential in zip(self._neurons, tick.potentials.tolist(), strict=True):
                self._view(topic, "std_msgs/msg/Float64MultiArray", prefix + _VALUE.pack(potential), wall_ns)

    def dock(self, result: DockResult) -> None:
        """Record how a docking ended."""
        self._record_json(DOCK_TOPIC, dump_json(result), self._clock.time_ns())

    def finish(self) -> None:
        """Record the whole path, dated at the start, so that viewers draw it from the beginning."""
        if self._path:
            data = path(self._path, self._began_ns, self._frame)
            self._view(PATH_TOPIC, "nav_msgs/msg/Path", data, self._began_ns)

    def status(self, status: DriverStatus) -> None:
        """Publish the drive's status."""
        self._link.publish("rover/status", text(dump_json(status).decode()), self._clock.time_ns())

    def _record_json(self, topic: str, json: bytes, wall_ns: int) -> None:
        """Record JSON that describes the moment ``wall_ns``, logged now as the link's messages are."""
        data = text(json.decode())
        self._record(Recorded(topic, "std_msgs/msg/String", data, self._clock.time_ns(), wall_ns))

    def _view(self, topic: str, ros_type: str, data: bytes, wall_ns: int) -> None:
        """Record a message for viewers alone, which draw it at its log time: the moment that it describes."""
        self._record(Recorded(topic, ros_type, data, wall_ns, wall_ns))
