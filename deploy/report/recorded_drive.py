"""A recording for a report: its policy and course, its settings, and the drive."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from deploy.report.timeline import Timeline
from rover_ncp.circuit.policy import Policy
from rover_ncp.circuit.policy_file import policy_from_yaml
from rover_ncp.core.config import parse_yaml, read_yaml
from rover_ncp.core.errors import FileError
from rover_ncp.core.recording import Recording, read_recording
from rover_ncp.course.course import TICK_S, Course, Verdict


@dataclass(frozen=True)
class Judged:
    """Verdict on a drive, and the pose that it is based on: ``true`` or ``estimated``."""

    verdict: Verdict
    by: str


@dataclass(frozen=True)
class Drive:
    """A recorded drive with at least one tick."""

    path: Path
    policy: Policy
    course: Course
    settings: dict[str, Any]
    """The driver's, as it wrote them; empty if the recording holds none."""
    timeline: Timeline
    complete: bool
    """False if the recording was cut off."""


def read_drive(path: Path) -> Drive:
    """Read a recording of ``rover-ncp deploy``. Raises FileError and ConfigError."""
    recording = read_recording(path)
    policy = policy_from_yaml(_attached(recording, "policy.yaml"), f"{path}, policy.yaml")
    course = parse_yaml(_attached(recording, "course.yaml"), Course, f"{path}, course.yaml")
    settings: Any = {}
    if "deploy.yaml" in recording.attachments:
        settings = read_yaml(_attached(recording, "deploy.yaml"), f"{path}, deploy.yaml")
    timeline = Timeline(policy, course)
    for message in recording.messages:
        timeline.take(message)
    if not timeline.ticks:
        raise FileError(f"{path}: holds no tick of a drive")
    return Drive(
        path, policy, course, settings if isinstance(settings, dict) else {}, timeline, recording.complete
    )


def judge(timeline: Timeline) -> tuple[Judged, ...]:
    """Judge a drive by the true pose if it is known, and by the estimate; the gate reports contacts."""
    began = timeline.ticks[0].wall_ns
    course, found = timeline.course, []
    until_ns = began + round((course.horizon_s + TICK_S) * 1e9)
    true = [moved for moved in timeline.truth if began <= moved.wall_ns <= until_ns]
    touched = "bumper" in (timeline.gate.stops if timeline.gate else {})
    if true:
        times = [(moved.wall_ns - began) * 1e-9 for moved in true]
        found.append(Judged(course.judge(times, [moved.pose for moved in true], touched), "true"))
    estimates = [tick.estimate for tick in timeline.ticks]
    if timeline.final is not None and timeline.final is not estimates[-1]:
        estimates.append(timeline.final)
    times = [(estimate.wall_ns - began) * 1e-9 for estimate in estimates]
    poses = [estimate.pose for estimate in estimates]
    found.append(Judged(course.judge(times, poses, touched), "estimated"))
    return tuple(found)


def _attached(recording: Recording, name: str) -> str:
    try:
        return recording.attachment(name).decode()
    except UnicodeDecodeError as error:
        raise FileError(f"{recording.path}: its {name} is no text") from error
