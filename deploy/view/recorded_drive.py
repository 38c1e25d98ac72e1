"""A recording for a report: its policy and course, its settings, its drive, and the summary of all this."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, NamedTuple

from deploy.drive.records import (
    STAGING_FILE,
    START_TOPIC,
    attached_course,
    attached_policy,
    attached_settings,
)
from deploy.place.outcome import DockResult, PoseErrors
from deploy.view.timeline import TOPICS, Moved, Tick, Timeline
from rover_ncp.circuit.policy import Policy
from rover_ncp.core.errors import FileError
from rover_ncp.core.geometry import relative
from rover_ncp.course.course import Course
from rover_ncp.course.scoring import Failure, Parked, Verdict
from rover_ncp.course.shapes import OUTLINE, FloatArray, outline_of
from rover_ncp.recording.recorded import steady
from rover_ncp.recording.recording import Recording, read_recording
from rover_ncp.robot.description import RobotDescription, recorded_robot
from rover_ncp.wire.protocol import DriverStatus

Rows = tuple[tuple[str, str], ...]
"""Names and values."""


KINDS: dict[str, str] = {Parked.YES: "good", Parked.UNCERTAIN: "doubt", Parked.NO: "bad"}
"""The colour of a verdict on a page."""
VERDICTS = {**{str(parked): parked for parked in Parked}, "fault": Parked.NO, "ended": Parked.NO}
"""The driver's verdict, by its last state; another state is that of a driver that was killed."""


@dataclass(frozen=True)
class Drive:
    """A recorded drive with at least one tick."""

    path: Path
    policy: Policy
    course: Course
    settings: dict[str, Any]
    """The driver's settings; empty if the recording holds none."""
    timeline: Timeline
    damage: str
    """Where the recording is cut off or damaged; empty if it is whole."""

    @property
    def names(self) -> str:
        """The policies that drove, and the course or place."""
        own, staging = self.policy.circuit.name, self.timeline.staging
        if self.settings.get("place") is None:
            return f"policy {own} on course {self.course.name}"
        if staging is None or not any(tick.staged for tick in self.timeline.ticks):
            return f"policy {own} at place {self.course.name}"
        return f"policies {staging.circuit.name} (to the staging pose) and {own} at place {self.course.name}"

    @property
    def docks(self) -> bool:
        """Whether it drives to or from a place."""
        return self.settings.get("place") is not None or self.timeline.dock is not None

    @property
    def robot(self) -> RobotDescription | None:
        """The robot that the driver's settings describe; None without ``--model``."""
        return recorded_robot(self.settings, f"{self.path}, deploy.yaml")

    @property
    def outline(self) -> FloatArray:
        """The outline of the described robot, or of a Pioneer 3-AT."""
        robot = self.robot
        return OUTLINE if robot is None else outline_of(robot)


class Summary(NamedTuple):
    """The result in words, the facts of the drive, and the origin of policy and program."""

    parked: Parked
    headline: str
    subline: str
    rows: Rows
    origin: Rows


def read_drive(path: Path) -> Drive:
    """Read a recording of ``rover-ncp deploy``. Raises FileError and ConfigError."""
    return drive_of(read_recording(path, topics=TOPICS | {START_TOPIC}))


def drive_of(recording: Recording) -> Drive:
    """Return the drive that a recording holds. Raises FileError and ConfigError."""
    path = recording.path
    if (drives := len(recording.topic(START_TOPIC))) > 1:
        raise FileError(f"{path}: holds {drives} drives, expected one: 'mcap filter' cuts a file by time")
    policy, course = attached_policy(recording), attached_course(recording)
    staging = attached_policy(recording, STAGING_FILE) if STAGING_FILE in recording.attachments else None
    timeline = Timeline(policy, course, staging)
    for message in steady(recording.messages):
        timeline.take(message)
    if not timeline.ticks:
        raise FileError(f"{path}: holds no tick of a drive")
    return Drive(path, policy, course, attached_settings(recording), timeline, recording.damage)


def summarise(drive: Drive) -> Summary:
    """Summarise a drive for its report."""
    dock, status = drive.timeline.dock, drive.timeline.status
    verdicts: dict[str, Verdict] | None = None
    if status is not None and status.state in VERDICTS:
        verdicts = {} if drive.docks else drive.timeline.judge()
    rows = list(facts(drive.timeline, verdicts))
    if drive.settings.get("dry_run"):
        rows.append(("Dry run", "no command was sent"))
    if drive.damage:
        rows.append(("Recording", f"{drive.damage}; the page shows what precedes it"))
    if dock is not None:
        parked, headline = _dock_headline(dock, status)
        rows[:0] = _dock_rows(dock, drive)
    elif status is not None and verdicts:
        parked, headline = _headline(verdicts, status)
    else:  # the driver was killed: only its own verdict says whether the rover is parked or docked
        what = "undocked from" if drive.settings.get("undock") else "docked at"
        goal = f"{what} {drive.course.name}" if drive.docks else "parked"
        parked, headline = Parked.NO, f"Not {goal}: the recording ends before the driver's verdict"
    began = datetime.fromtimestamp(drive.timeline.ticks[0].wall_ns * 1e-9, UTC)
    return Summary(
        parked=parked,
        headline=headline,
        subline=f"{drive.names}, {began:%Y-%m-%d %H:%M:%S} UTC",
        rows=tuple(rows),
        origin=tuple(_origin(drive)),
    )


def _headline(verdicts: Mapping[str, Verdict], status: DriverStatus) -> tuple[Parked, str]:
    """Return the verdict and its words, which say if the true pose was judged and not the driver's."""
    by, verdict = next(iter(verdicts.items()))
    parked, reason = verdict.words, verdict.reason
    if by == "estimated" and parked is Parked.YES:
        parked = VERDICTS[status.state]
        reason = status.reason
    if parked is Parked.UNCERTAIN or verdict.failure is Failure.EARLY:
        reason = status.reason or reason
    if by == "true" and parked is Parked.YES and status.state == Parked.UNCERTAIN:
        reason = "the driver's own verdict is uncertain"
    words = parked.capitalize() + (" (true pose)" if by == "true" else "")
    return parked, words + (f": {reason}" if reason else "")


def _dock_headline(dock: DockResult, status: DriverStatus | None) -> tuple[Parked, str]:
    """Return how a docking ended, and in words; an undocking may be uncertain."""
    words = dock.headline[0].upper() + dock.headline[1:]
    if dock.success and status is not None and status.state == Parked.UNCERTAIN:
        return Parked.UNCERTAIN, f"{words}, uncertain: {status.reason}"
    return Parked.YES if dock.success else Parked.NO, words


def _dock_rows(dock: DockResult, drive: Drive) -> Iterator[tuple[str, str]]:
    """Yield how a docking ended, with the errors of the pose at the end of its last approach."""
    yield "Docking", str(dock) + ("" if dock.probability is None else f"; probability {dock.probability:.0%}")
    if drive.timeline.truth and dock.at == "place":
        goal, true = drive.course.goal, drive.timeline.truth[-1].pose
        off = relative(goal, true)
        yield "By the true pose", str(PoseErrors(longitudinal_m=off.x, lateral_m=off.y, yaw_rad=off.theta))


def facts(timeline: Timeline, verdicts: Mapping[str, Verdict] | None) -> Iterator[tuple[str, str]]:
    """Yield the facts of a drive as names and values; ``verdicts`` are those of an ended drive."""
    ended = verdicts is not None
    for by, verdict in (verdicts or {}).items():
        yield f"By the {by} pose", _verdict(verdict)
    status, gate = timeline.status, timeline.gate
    if status is not None:
        reason = f": {status.reason}" if status.reason else ""
        yield "Ended as" if ended else "State", timeline.in_words(status.state) + reason
        if status.error_95_m is not None:
            most = f"up to {1000 * status.error_95_m:.0f} mm from the true position in 95 % of drives"
            yield "Estimate", most + ("; this is no error of the docking" if timeline.dock else "")
    late = f"{status.overruns if status else 0} late, {timeline.predicted} on prediction"
    yield "Ticks", f"{_rate(timeline.ticks)}, {late}"
    yield "Odometry", _rate(timeline.odometry)
    if gate is not None:
        counts = [f"{gate.accepted} commands accepted"]
        for what, by_reason in (("dropped", gate.dropped), ("limited", gate.limited), ("stops", gate.stops)):
            counts.append(f"{sum(by_reason.values())} {what}{_reasons(by_reason)}")
        yield "Gate", ", ".join(counts)
    if timeline.voltages:
        yield "Battery", f"{min(timeline.voltages):.1f} to {max(timeline.voltages):.1f} V"
    if timeline.unreadable:
        yield "Unreadable", f"{timeline.unreadable.total()} messages{_reasons(timeline.unreadable)}"


def _verdict(verdict: Verdict) -> str:
    where = f"{1000 * verdict.error_m:.0f} mm and {1000 * verdict.error_rad:.0f} mrad from the goal"
    sure = "" if verdict.probability is None else f", within the tolerances with {verdict.probability:.0%}"
    return f"{verdict.words}, {where}{sure}" + (f": {verdict.reason}" if verdict.reason else "")


def _rate(rows: Sequence[Tick | Moved]) -> str:
    count = len(rows)
    if count < 2 or rows[-1].wall_ns <= rows[0].wall_ns:
        return f"{count}"
    return f"{count} at {(count - 1) / (rows[-1].wall_ns - rows[0].wall_ns) * 1e9:.2f} Hz"


def _reasons(counts: Mapping[str, int]) -> str:
    return f" ({', '.join(f'{name} {count}' for name, count in counts.items())})" if counts else ""


def _origin(drive: Drive) -> Iterator[tuple[str, str]]:
    made = drive.policy.provenance
    value = made.get("return")
    if isinstance(value, int | float):
        yield "Return in simulation", f"{value:.4f}".replace("-", "−")
    if isinstance(made.get("command"), str):
        yield "Trained by", made["command"]
    versions = made.get("made_with")
    if isinstance(versions, Mapping):
        yield "With", ", ".join(f"{name} {version}" for name, version in versions.items())
    if "version" in drive.settings:
        yield "Driven with", f"rover-ncp {drive.settings['version']}"
    yield "Recording", drive.path.name
