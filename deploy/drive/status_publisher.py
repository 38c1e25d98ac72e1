"""Messages that a drive publishes and records for each tick."""

import time
from collections.abc import Callable, Sequence

from deploy.drive.controller import Tick
from deploy.drive.link import Link
from deploy.drive_records import START_TOPIC, TICKS_TOPIC, StartRecord, TickRecord
from deploy.estimator.estimator import Estimate
from deploy.viewer_topics import Views
from rover_ncp.core.geometry import Pose
from rover_ncp.core.messages import COURSE_FRAME, neurons, pose_with_covariance, text
from rover_ncp.core.process import Clock
from rover_ncp.core.protocol import DriverStatus, dump_json
from rover_ncp.core.recording import Recorded

_JSON = "std_msgs/msg/String"


def estimate_message(estimate: Estimate, wall_ns: int) -> bytes:
    """Return the estimate's pose with its 3 × 3 covariance as it goes over the wire."""
    return pose_with_covariance(estimate.pose, estimate.covariance[:3, :3], wall_ns, COURSE_FRAME)


class Reporter:
    """Publishes and records; nothing here decides anything."""

    def __init__(
        self,
        link: Link,
        record: Callable[[Recorded], None],
        neuron_names: Sequence[str],
        clock: Clock = time,
    ) -> None:
        self._link, self._record, self._names, self._clock = link, record, neuron_names, clock
        self._views = Views(record, neuron_names, COURSE_FRAME)

    def start(self, record: StartRecord, odometry: Pose) -> None:
        """Record how the drive began, where odometry stood at ``odometry``."""
        wall_ns = self._clock.time_ns()
        self._note(START_TOPIC, dump_json(record), wall_ns)
        self._views.start(wall_ns, Pose(*record.pose), odometry)

    def tick(self, record: TickRecord, estimate: Estimate, tick: Tick | None) -> None:
        """Publish the estimate, and the potentials if the circuit ran."""
        self._note(TICKS_TOPIC, dump_json(record), record.wall_ns)
        self._link.publish("rover/estimate", estimate_message(estimate, record.wall_ns), record.wall_ns)
        if tick is not None:
            self._link.publish("rover/neurons", neurons(tick.potentials, self._names), record.wall_ns)
        self._views.tick(record.wall_ns, estimate.pose, None if tick is None else tick.potentials)

    def finish(self) -> None:
        """Record the messages that need the whole drive."""
        self._views.finish()

    def status(self, status: DriverStatus) -> None:
        """Publish the drive's status."""
        self._link.publish("rover/status", text(dump_json(status).decode()), self._clock.time_ns())

    def _note(self, topic: str, json: bytes, wall_ns: int) -> None:
        self._record(Recorded(topic, _JSON, text(json.decode()), self._clock.time_ns(), wall_ns))
