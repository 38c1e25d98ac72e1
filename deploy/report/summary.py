"""Summary of a report: result, reason, rates, versions."""

from collections.abc import Iterator, Mapping
from datetime import UTC, datetime
from typing import Any, NamedTuple

import numpy as np

from deploy.report.recorded_drive import Drive, Judged, judge
from rover_ncp.course.course import Verdict


class Summary(NamedTuple):
    """A headline, rows of name and value, and rows of the origin of policy and program."""

    parked: bool
    headline: str
    subline: str
    rows: tuple[tuple[str, str], ...]
    origin: tuple[tuple[str, str], ...]


def summarise(drive: Drive) -> Summary:
    """Put a drive into words."""
    timeline, judged = drive.timeline, judge(drive.timeline)
    first = judged[0].verdict
    ending = "Parked" if first.parked else f"Not parked: {first.reason}"
    rows = [(f"By the {one.by} pose", _verdict(one)) for one in judged]
    status, gate = timeline.status, timeline.gate
    if status is not None:
        rows.append(("Ended as", status.state + (f": {status.reason}" if status.reason else "")))
    late = f"{status.overruns if status else 0} late, {timeline.predicted} on prediction"
    times = np.array([tick.wall_ns for tick in timeline.ticks]) * 1e-9
    rows.append(("Ticks", f"{len(times)} at {_rate(times)}, {late}"))
    rows.append(("Odometry", _rate(np.array([moved.wall_ns for moved in timeline.odometry]) * 1e-9)))
    if gate is not None:
        counts = [f"{gate.accepted} commands accepted"]
        for what, by in (("dropped", gate.dropped), ("limited", gate.limited), ("stops", gate.stops)):
            counts.append(f"{sum(by.values())} {what}{_reasons(by)}")
        rows.append(("Gate", ", ".join(counts)))
    if timeline.voltages:
        rows.append(("Battery", f"{min(timeline.voltages):.1f} to {max(timeline.voltages):.1f} V"))
    if drive.settings.get("dry_run"):
        rows.append(("Dry run", "no command was sent"))
    if not drive.complete:
        rows.append(("Recording", "cut off; this is what it holds"))
    if timeline.unreadable:
        rows.append(
            ("Unreadable", f"{sum(timeline.unreadable.values())} messages{_reasons(timeline.unreadable)}")
        )
    began = datetime.fromtimestamp(timeline.ticks[0].wall_ns * 1e-9, UTC)
    subline = (
        f"policy {drive.policy.circuit.name} on course {drive.course.name}, {began:%Y-%m-%d %H:%M:%S} UTC"
    )
    return Summary(first.parked, ending, subline, tuple(rows), tuple(_origin(drive)))


def _verdict(judged: Judged) -> str:
    verdict: Verdict = judged.verdict
    where = f"{1000 * verdict.error_m:.0f} mm and {1000 * verdict.error_rad:.0f} mrad from the goal"
    return f"parked, {where}" if verdict.parked else f"not parked, {where}: {verdict.reason}"


def _rate(times: np.ndarray[Any, np.dtype[np.float64]]) -> str:
    if len(times) < 2 or times[-1] <= times[0]:
        return "one alone" if len(times) else "none"
    return f"{(len(times) - 1) / (times[-1] - times[0]):.2f} Hz"


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
