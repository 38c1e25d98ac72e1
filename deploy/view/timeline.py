"""A drive in order, built message by message: from a recording, or from a robot while it drives.

Reads the topics of `rover_ncp.wire.key_table`, the true pose that the mock adds, and of the driver's own
records only whether a tick ran on prediction. A message that cannot be decoded is counted and left out. Times
are ns of one clock that is never set: in a recording that of `steady`, live the viewer's monotonic clock.
"""

import math
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from itertools import groupby
from typing import Any, NamedTuple

import numpy as np
from pydantic import BaseModel

from deploy.place.outcome import DOCK_TOPIC, DockResult, Stage
from rover_ncp.circuit.policy import Policy
from rover_ncp.core.errors import FormatError
from rover_ncp.core.geometry import STANDSTILL, Pose, Velocity, compose, inverse
from rover_ncp.course.course import TICK_S, Course
from rover_ncp.course.scoring import Parked, Verdict, judge
from rover_ncp.neurons.trace import FloatArray, Trace, motor_outputs
from rover_ncp.recording.recorded import TICKS_TOPIC
from rover_ncp.recording.recording import Recorded
from rover_ncp.wire.cdr import decode
from rover_ncp.wire.key_table import TAG_VIEW, spec
from rover_ncp.wire.messages import (
    read_battery,
    read_bumpers,
    read_neurons,
    read_odometry,
    read_pose,
    read_pose_stamped,
    read_text,
    read_twist,
)
from rover_ncp.wire.protocol import DriverStatus, GateStatus, parse_json

TRUTH_TOPIC = "truth/pose"
STAGES = tuple(map(str, Stage))
"""A docking's driver reports its stage as its state."""
MAX_VALUE = 1e9
"""Limit for poses in m and rad, covariances and potentials in mV: larger numbers overflow when squared."""


class Estimated(NamedTuple):
    """The driver's estimate; the covariance (3, 3) is that of x, y and theta."""

    wall_ns: int
    pose: Pose
    covariance: FloatArray


class Tick(NamedTuple):
    """One control tick: the estimate at its start and the potentials (n,) in mV at its end."""

    wall_ns: int
    estimate: Estimated
    potentials: FloatArray
    stage: str = ""
    """The stage of a docking with its try, as the driver's status has them; "" for a drive of a course."""

    @property
    def staged(self) -> bool:
        """Whether the policy drove that drives to the staging pose of a place."""
        return self.stage.startswith(Stage.NAV_TO_STAGING_POSE)


class Moved(NamedTuple):
    """The rover's pose, and its velocity if that is known."""

    wall_ns: int
    pose: Pose
    velocity: Velocity = STANDSTILL


class Command(NamedTuple):
    """A commanded velocity."""

    wall_ns: int
    velocity: Velocity


class Event(NamedTuple):
    """A change that a user should see; ``kind`` is state, start, gate, stop or late."""

    wall_ns: int
    kind: str
    text: str


class _TickRecord(BaseModel):
    """What the page needs of a tick's record; recordings of older versions have it too."""

    index: int
    predicted: bool


class Timeline:
    """All data of a drive, in order. Poses of ``odometry`` are in the odometry frame.

    ``staging`` is the policy that drives to the staging pose of a place, if it is known.
    """

    def __init__(self, policy: Policy, course: Course, staging: Policy | None = None) -> None:
        self.policy, self.course, self.staging = policy, course, staging
        self.ticks: list[Tick] = []
        self.final: Estimated | None = None
        """The newest estimate; after the last tick there is one more."""
        self.odometry: list[Moved] = []
        self.truth: list[Moved] = []
        self.commands: list[Command] = []
        self.setpoints: list[Command] = []
        self.voltages: list[float] = []
        self.pictures: list[tuple[int, bytes]] = []
        """Times and JPEGs of a localiser's pictures."""
        self.touched = False
        """Whether the base reported a contact during the drive."""
        self.predicted = 0
        self.foreign = False
        """Whether neurons arrived that are not those of the policy."""
        self.other = ""
        """Why the policy and the course are not those of the drive; "" if they are, as in a recording."""
        self.unreadable: Counter[str] = Counter()
        self.status: DriverStatus | None = None
        self.dock: DockResult | None = None
        """How a docking ended."""
        self.gate: GateStatus | None = None
        """The newest state; its counters are this drive's."""
        self._gate_before = GateStatus()
        """The gate before the drive: its counters are since the bridge's start."""
        self._events: list[Event] = []
        self._course_odom: Pose | None = None

    def take(self, message: Recorded) -> None:
        """Add the next message; ignore other topics."""
        reader = _READERS.get(message.topic)
        if reader is None:
            return
        try:
            reader(self, message)
        except FormatError:
            self.unreadable[message.topic] += 1

    @property
    def began_ns(self) -> int | None:
        """The time of the first tick; None before it."""
        return self.ticks[0].wall_ns if self.ticks else None

    @property
    def streams(self) -> dict[str, Sequence[Any]]:
        """All rows that a page shows over time, by the stream's name there."""
        return {
            "ticks": self.ticks,
            "odometry": self.odometry,
            "truth": self.truth,
            "commands": self.commands,
            "setpoints": self.setpoints,
        }

    @property
    def events(self) -> list[Event]:
        """Events in order, with the start signal once a tick has seen it."""
        events = [
            event._replace(text=self.in_words(event.text)) if event.kind == "state" else event
            for event in self._events
        ]
        if self.ticks and not self.other:
            signal = self.ticks[0].wall_ns + round(self.course.start_signal_s * 1e9)
            if self.ticks[-1].wall_ns >= signal:
                events.append(Event(signal, "start", "start signal"))
        return list(_joined(sorted(events, key=lambda event: event.wall_ns)))

    def in_words(self, state: str) -> str:
        """Return the driver's state; of a docking that succeeded, the driver says parked."""
        if self.dock is None or state != Parked.YES:
            return state
        return "undocked" if self.dock.undock else "docked"

    def on_course(self, odometry: Pose) -> Pose | None:
        """Return a pose of odometry in the course frame; None before the first tick."""
        return None if self._course_odom is None else compose(self._course_odom, odometry)

    def traces(self) -> list[Trace]:
        """Return the drive, which has a tick, as runs of its circuits, in order: one of each stage of a try.

        No circuit drives a rover that waits for the charge: that stage is left out, unless there is no other.
        """
        stages = [list(pairs) for _, pairs in groupby(self._pairs(), key=lambda pair: pair[0].stage)]
        driven = [pairs for pairs in stages if not pairs[0][0].stage.startswith(Stage.WAIT_FOR_CHARGE)]
        return [self._trace(pairs) for pairs in driven or stages]

    def _trace(self, pairs: Sequence[tuple[Tick, Pose]]) -> Trace:
        policy = self.staging if pairs[0][0].staged and self.staging else self.policy
        potentials = np.array([tick.potentials for tick, _ in pairs])
        return Trace(
            policy=policy,
            times=np.array([(tick.wall_ns - self.ticks[0].wall_ns) * 1e-9 for tick, _ in pairs]),
            poses=np.array([*(tick.estimate.pose for tick, _ in pairs), pairs[-1][1]]),
            commands=motor_outputs(policy, potentials),
            potentials=potentials,
        )

    def _pairs(self) -> list[tuple[Tick, Pose]]:
        """Return all ticks, each with the pose at its end."""
        last = self.ticks[-1].estimate if self.final is None else self.final
        later = [*(tick.estimate.pose for tick in self.ticks[1:]), last.pose]
        return list(zip(self.ticks, later, strict=True))

    def judge(self) -> dict[str, Verdict]:
        """Return the verdicts, after a tick, by the ``true`` pose, if it is known, and the ``estimated`` one.

        The base reports contacts.
        """
        began, horizon_ns = self.ticks[0].wall_ns, round(self.course.horizon_s * 1e9)
        if self.final is not None and self.status is not None and self.status.tick >= self.course.ticks:
            # The driver drove to the horizon. A stall may have made its first tick late.
            began = min(began, self.final.wall_ns - horizon_ns)
        until = began + horizon_ns + round(TICK_S * 1e9)
        estimates = [tick.estimate for tick in self.ticks]
        if self.final is not None and self.final is not estimates[-1]:
            estimates.append(self.final)
        paths: dict[str, Sequence[Moved | Estimated]] = {
            "true": [moved for moved in self.truth if began <= moved.wall_ns <= until],
            "estimated": estimates,
        }
        return {
            by: judge(
                self.course,
                [(p.wall_ns - began) * 1e-9 for p in path],
                [p.pose for p in path],
                self.touched,
                getattr(path[-1], "covariance", None),
            )
            for by, path in paths.items()
            if path
        }

    def _read_estimate(self, message: Recorded) -> None:
        sample = read_pose(message.data)
        _require_sane([*sample.pose, *sample.covariance.ravel()])
        self.final = Estimated(message.publish_ns, sample.pose, sample.covariance)

    def _read_neurons(self, message: Recorded) -> None:
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

    def _read_odometry(self, message: Recorded) -> None:
        sample = read_odometry(message.data)
        self.odometry.append(Moved(message.log_ns, sample.pose, sample.velocity))

    def _read_truth(self, message: Recorded) -> None:
        pose = read_pose_stamped(message.data)
        _require_sane(pose)
        self.truth.append(Moved(message.log_ns, pose))

    def _read_status(self, message: Recorded) -> None:
        before, self.status = self.status, parse_json(DriverStatus, read_text(message.data))
        if self.ticks and self.status.state.startswith(STAGES):
            self.ticks[-1] = self.ticks[-1]._replace(stage=self.status.state)
        self._events += [Event(message.log_ns, *event) for event in _driver_events(before, self.status)]

    def _read_gate(self, message: Recorded) -> None:
        now, before = parse_json(GateStatus, read_text(message.data)), self.gate or GateStatus()
        if not self.ticks and (self.gate is None or not now.lease):
            self._gate_before = now
        self.gate = _since(self._gate_before, now)
        if self.ticks and (before.lease or now.lease):
            self.touched |= bool(now.contact_since(self._gate_before))
        self._events += [Event(message.log_ns, *event) for event in _gate_events(before, self.gate)]

    def _read_bumpers(self, message: Recorded) -> None:
        if self.ticks and self.gate is not None and self.gate.lease:
            self.touched |= any(read_bumpers(message.data))

    def _read_battery(self, message: Recorded) -> None:
        if math.isfinite(volts := read_battery(message.data).voltage):
            self.voltages.append(volts)

    def _read_picture(self, message: Recorded) -> None:
        self.pictures.append((message.log_ns, read_jpeg(message.data)))

    def _read_dock(self, message: Recorded) -> None:
        self.dock = parse_json(DockResult, read_text(message.data))

    def _read_record(self, message: Recorded) -> None:
        tick = parse_json(_TickRecord, read_text(message.data))
        if tick.predicted:
            self.predicted += 1
            words = f"no odometry in time: tick {tick.index} ran on prediction; the drive went on"
            self._events.append(Event(message.log_ns, "late", words))


_READERS: dict[str, Callable[[Timeline, Recorded], None]] = {
    "rover/estimate": Timeline._read_estimate,
    "rover/neurons": Timeline._read_neurons,
    "odom": Timeline._read_odometry,
    "cmd_vel": lambda timeline, message: timeline.commands.append(_command(message)),
    "rover/cmd_out": lambda timeline, message: timeline.setpoints.append(_command(message)),
    "rover/status": Timeline._read_status,
    "rover/gate": Timeline._read_gate,
    "battery_state": Timeline._read_battery,
    "bumpers": Timeline._read_bumpers,
    TRUTH_TOPIC: Timeline._read_truth,
    TICKS_TOPIC: Timeline._read_record,
    DOCK_TOPIC: Timeline._read_dock,
    TAG_VIEW: Timeline._read_picture,
}
TOPICS = frozenset(_READERS)
"""Topics that a timeline reads."""


def _since(before: GateStatus, now: GateStatus) -> GateStatus:
    """Return the gate's state with the counters of the time between two states."""
    more: dict[str, Any] = {"accepted": max(0, now.accepted - before.accepted)}
    for name in ("dropped", "limited", "stops"):
        more[name] = dict(Counter(getattr(now, name)) - Counter(getattr(before, name)))
    return now.model_copy(update=more)


def _driver_events(before: DriverStatus | None, now: DriverStatus) -> Iterator[tuple[str, str]]:
    if before is None or now.state != before.state:
        yield "stop" if now.state == "fault" else "state", now.state + _because(now.reason)
    if before is not None and now.overruns > before.overruns:
        yield "late", f"tick {now.tick} was late: this computer was busy; the drive went on"


def _joined(events: Sequence[Event]) -> Iterator[Event]:
    """Return the events, those of ticks that were late in a row as one: a busy computer has many."""
    for late, row in groupby(events, key=lambda event: event.kind == "late"):
        first, *more = row
        if late and more:
            span_s = (more[-1].wall_ns - first.wall_ns) * 1e-9
            yield first._replace(text=f"{first.text}; {len(more)} more within {span_s:.1f} s")
        else:
            yield from (first, *more)


def _gate_events(before: GateStatus, now: GateStatus) -> Iterator[tuple[str, str]]:
    # Before its first command a rover is held by design.
    if now.held and now.held != before.held and now.accepted:
        yield "stop", f"the gate holds the rover, {now.held}{_because(now.stop_reason)}"
    if before.held and not now.held and before.accepted:
        yield "gate", "the gate passes commands again"
    if now.ended and now.ended != before.ended:
        yield "stop", f"the gate revoked the lease, {now.ended}{_because(now.ended_detail)}"
    for verb, then, counts in (
        ("dropped", before.dropped, now.dropped),
        ("limited", before.limited, now.limited),
    ):
        # Only the first of a kind is an event; the summary counts the others.
        for reason in counts:
            if reason not in then:
                yield "gate", f"the gate {verb} a command for the first time, {reason}"


def _because(reason: str) -> str:
    return f": {reason}" if reason else ""


def _require_sane(values: Sequence[float]) -> None:
    """Raise FormatError for numbers that no drive has; NaN is one of them."""
    if not (np.abs(values) <= MAX_VALUE).all():
        raise FormatError(
            f"numbers from {np.min(values):g} to {np.max(values):g}, expected at most {MAX_VALUE:g}"
        )


def read_jpeg(data: bytes) -> bytes:
    """Return the JPEG of a localiser's picture. Raises FormatError."""
    return bytes(decode(spec(TAG_VIEW).type, data).data)


def _command(message: Recorded) -> Command:
    return Command(message.log_ns, read_twist(message.data).velocity)
