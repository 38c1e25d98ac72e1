"""A drive put together from its messages, one after the other: of a recording, or as they come in live.

Knows the topics of `rover_ncp.core.key_table`, the true pose that a simulator's judge adds, and of the
driver's own records only whether a tick ran on prediction. A message that cannot be read is counted and
left out. Times are ns of one wall clock. In a recording it is the driver's, which stamps its ticks. Live, it
is the viewer's, and all times are those of arrival.
"""

import json
from collections import Counter
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from deploy.report.drive_events import Event, Watcher
from deploy.report.trace import Trace, motor_outputs
from rover_ncp.circuit.policy import Policy
from rover_ncp.core.cdr import decode
from rover_ncp.core.errors import FormatError
from rover_ncp.core.geometry import Pose, Velocity, compose, inverse
from rover_ncp.core.messages import read_neurons, read_odometry, read_pose, read_text, read_twist
from rover_ncp.core.protocol import DriverStatus, GateStatus, parse_json
from rover_ncp.core.recording import Recorded
from rover_ncp.course.course import Course

FloatArray = NDArray[np.float64]

TRUTH_TOPIC = "truth/pose"
TICKS_TOPIC = "deploy/ticks"
MOST = 1e9
"""Of a pose in m and rad, a covariance, or a potential in mV."""


class Estimated(NamedTuple):
    """The driver's estimate; the covariance (3, 3) is that of x, y and theta."""

    wall_ns: int
    pose: Pose
    covariance: FloatArray


class Tick(NamedTuple):
    """One control tick: the estimate it was made from, and the potentials (n,) in mV it led to."""

    wall_ns: int
    estimate: Estimated
    potentials: FloatArray


class Moved(NamedTuple):
    """The rover's pose, and its motion if that is known."""

    wall_ns: int
    pose: Pose
    velocity: Velocity | None = None


class Command(NamedTuple):
    """A velocity that was commanded, or that the gate passed."""

    wall_ns: int
    velocity: Velocity


class Timeline:
    """All data of a drive, in order. Poses of ``odometry`` are in its own frame."""

    def __init__(self, policy: Policy, course: Course) -> None:
        self.policy, self.course = policy, course
        self.ticks: list[Tick] = []
        self.final: Estimated | None = None
        """The estimate after the last tick."""
        self.odometry: list[Moved] = []
        self.truth: list[Moved] = []
        self.asked: list[Command] = []
        self.let_through: list[Command] = []
        self.voltages: list[float] = []
        self.predicted = 0
        self.foreign = False
        """Whether neurons came that are not those of the policy."""
        self.unreadable: Counter[str] = Counter()
        self._watcher = Watcher()
        self._course_odom: Pose | None = None
        self._readers = {
            "rover/estimate": self._estimate,
            "rover/neurons": self._neurons,
            "odom": self._odometry,
            "cmd_vel": lambda message: self.asked.append(_command(message)),
            "rover/cmd_out": lambda message: self.let_through.append(_command(message)),
            "rover/status": self._status,
            "rover/gate": self._gate,
            "battery_state": self._battery,
            TRUTH_TOPIC: self._truth,
            TICKS_TOPIC: self._record,
        }

    def take(self, message: Recorded) -> None:
        """Add the next message; ignore other topics."""
        reader = self._readers.get(message.topic)
        if reader is None:
            return
        try:
            reader(message)
        except FormatError:
            self.unreadable[message.topic] += 1

    @property
    def began_ns(self) -> int | None:
        """The moment of the first tick, from which times count; None before it."""
        return self.ticks[0].wall_ns if self.ticks else None

    @property
    def status(self) -> DriverStatus | None:
        """The driver's last status."""
        return self._watcher.status

    @property
    def gate(self) -> GateStatus | None:
        """The gate's last status."""
        return self._watcher.gate

    @property
    def events(self) -> list[Event]:
        """Events in order; the start signal is among them once a tick has seen it."""
        events = list(self._watcher.events)
        if self.ticks:
            signal = self.ticks[0].wall_ns + round(self.course.start_signal_s * 1e9)
            if self.ticks[-1].wall_ns >= signal:
                events.append(Event(signal, "start", "start signal"))
        return sorted(events, key=lambda event: event.wall_ns)

    def on_course(self, odometry: Pose) -> Pose | None:
        """Return a pose of odometry in the course's frame; None before the first tick."""
        return None if self._course_odom is None else compose(self._course_odom, odometry)

    def trace(self) -> Trace:
        """Return the drive as a run of its circuit. Raises ValueError before the first tick."""
        if not self.ticks:
            raise ValueError("a drive without a tick has no trace")
        began = self.ticks[0].wall_ns
        potentials = np.array([tick.potentials for tick in self.ticks])
        poses = [tick.estimate.pose for tick in self.ticks]
        poses.append(poses[-1] if self.final is None else self.final.pose)
        return Trace(
            policy=self.policy,
            times=np.array([(tick.wall_ns - began) * 1e-9 for tick in self.ticks]),
            poses=np.array(poses),
            commands=motor_outputs(self.policy, potentials),
            potentials=potentials,
        )

    def _estimate(self, message: Recorded) -> None:
        sample = read_pose(message.data)
        _require_sane([*sample.pose, *sample.covariance.ravel()])
        self.final = Estimated(message.publish_ns, sample.pose, sample.covariance)

    def _neurons(self, message: Recorded) -> None:
        potentials = read_neurons(message.data)
        if tuple(potentials) != self.policy.circuit.neurons:
            self.foreign = True
            raise FormatError(f"neurons {', '.join(potentials)} are not those of the policy")
        _require_sane(list(potentials.values()))
        if self.final is None:
            return  # the viewer joined between a tick's estimate and its neurons
        if not self.ticks:
            start = self.odometry[-1].pose if self.odometry else Pose(0.0, 0.0, 0.0)
            self._course_odom = compose(self.final.pose, inverse(start))
        self.ticks.append(Tick(message.publish_ns, self.final, np.array(list(potentials.values()))))

    def _odometry(self, message: Recorded) -> None:
        sample = read_odometry(message.data)
        self.odometry.append(Moved(message.log_ns, sample.pose, sample.velocity))

    def _truth(self, message: Recorded) -> None:
        pose = decode(message.type, message.data).pose
        _require_sane([pose.position.x, pose.position.y, pose.orientation.z, pose.orientation.w])
        yaw = 2.0 * np.arctan2(pose.orientation.z, pose.orientation.w)
        self.truth.append(Moved(message.log_ns, Pose(pose.position.x, pose.position.y, float(yaw))))

    def _status(self, message: Recorded) -> None:
        self._watcher.driver(message.log_ns, parse_json(DriverStatus, read_text(message.data)))

    def _gate(self, message: Recorded) -> None:
        self._watcher.bridge(message.log_ns, parse_json(GateStatus, read_text(message.data)))

    def _battery(self, message: Recorded) -> None:
        self.voltages.append(float(decode(message.type, message.data).voltage))

    def _record(self, message: Recorded) -> None:
        try:
            record = json.loads(read_text(message.data))
            predicted, index = bool(record["predicted"]), int(record["index"])
        except (ValueError, KeyError, TypeError) as error:
            raise FormatError(f"{TICKS_TOPIC}: {error}") from error
        if predicted:
            self.predicted += 1
            words = f"no odometry in time: tick {index} ran on prediction"
            self._watcher.events.append(Event(message.log_ns, "late", words))


def _require_sane(values: Sequence[float]) -> None:
    """Raise FormatError for numbers that no drive has, and whose squares or sums would overflow."""
    if not (np.abs(values) <= MOST).all():  # NaN is not, either
        raise FormatError(f"numbers from {np.min(values):g} to {np.max(values):g}, expected {MOST:g} at most")


def _command(message: Recorded) -> Command:
    return Command(message.log_ns, read_twist(message.data).velocity)
