"""Everything about one circuit on one course: its run read, and what becomes of it when parts are missing.

The run is a simulated one, or one that was recorded; the what-ifs are always simulated.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rover_ncp.circuit.policy import Policy
from rover_ncp.circuit.policy_file import load_policy
from rover_ncp.core.course import Course, Verdict, load_course
from rover_ncp.core.files import write_atomic
from rover_ncp.report.analysis import Analysis, analyse
from rover_ncp.report.files import pictures, table, tables
from rover_ncp.report.interpret import THRESHOLD, Contribution
from rover_ncp.report.picture import Picture
from rover_ncp.report.picture_bars import Outcome, Swing, outcomes, swings
from rover_ncp.report.published import CONTRIBUTIONS, TIME_CONSTANTS_S
from rover_ncp.report.recorded import judge, read_drive
from rover_ncp.report.trace import Trace
from sim.explain.knockout import Knockout, knock_outs
from sim.explain.sensitivity import STEP, Sensitivity, sensitivities
from sim.learn.rollout import Rollout, rollout

__all__ = ["Explained", "explain", "write"]

SHOWN = 25
"""Parameters in the picture of sensitivities."""


@dataclass(frozen=True, eq=False)
class Explained:
    """What ``rover-ncp explain`` found."""

    source: str
    policy: Policy
    course: Course
    verdict: Verdict
    """Of the run that was explained."""
    intact: Rollout
    """The simulated run, against which the what-ifs are held."""
    analysis: Analysis
    knock_outs: tuple[Knockout, ...]
    sensitivities: tuple[Sensitivity, ...]

    def fields(self) -> dict[str, Any]:
        """Return everything but the potentials as plain values."""
        analysis, pairs = self.analysis, [(a, b) for b in self.analysis.motors for a in self.analysis.sources]
        return {
            "source": self.source,
            "policy": self.policy.circuit.name,
            "course": self.course.name,
            "run": {
                "parked": self.verdict.parked,
                "reason": self.verdict.reason,
                "error_m": self.verdict.error_m,
                "error_rad": self.verdict.error_rad,
            },
            "simulated": {"return": self.intact.total, "parked": self.intact.verdict.parked},
            "phases": [_phase(told) for told in analysis.explanations],
            "threshold": analysis.threshold,
            "contributions": [
                _contribution(analysis.contributions[pair], analysis.driving[pair]) for pair in pairs
            ],
            "time_constants": [
                {**row._asdict(), "paper_s": TIME_CONSTANTS_S.get(row.neuron)}
                for row in analysis.time_constants
            ],
            "knock_outs": [vars(row) for row in self.knock_outs],
            "sensitivities": [{**vars(row), "slope": row.slope} for row in self.sensitivities],
        }


def explain(
    source: str,
    course: str | None = None,
    *,
    threshold: float = THRESHOLD,
    on_progress: Callable[[str], None] = lambda _: None,
) -> Explained:
    """Explain a policy (name or file) on a course, or a recording (``.mcap``) on the one it holds.

    Raises FileError and ConfigError.
    """
    if Path(source).suffix == ".mcap":
        drive = read_drive(Path(source))
        policy, known = drive.policy, drive.course if course is None else load_course(course)
        trace, verdict = drive.timeline.trace(), judge(drive.timeline)[0].verdict
        intact = rollout(policy, known)
    else:
        policy = load_policy(source)
        known = load_course(course or "parking")
        intact = rollout(policy, known)
        trace, verdict = traced(policy, intact), intact.verdict
    parts = policy.circuit.size + policy.circuit.synapse_count
    on_progress(f"driving the course without each of {parts} neurons and synapses")
    without = knock_outs(policy, known, intact)
    on_progress(f"moving each of {policy.layout().size} parameters a little")
    return Explained(
        source=source,
        policy=policy,
        course=known,
        verdict=verdict,
        intact=intact,
        analysis=analyse(trace, threshold),
        knock_outs=without,
        sensitivities=sensitivities(policy, known),
    )


def traced(policy: Policy, run: Rollout) -> Trace:
    """Return a simulated run as reports see it."""
    return Trace(policy, run.times[:-1], run.poses, run.commands, run.potentials)


def write(found: Explained, folder: Path) -> list[Path]:
    """Write tables, pictures and sentences into a folder; return what was written. Raises FileError."""
    files: dict[str, bytes | str] = {"explanation.md": _prose(found)}
    for name, text in {**tables(found.analysis), **_more_tables(found)}.items():
        files[f"{name}.csv"] = text
    for name, picture in _pictures(found).items():
        files |= {f"{name}.svg": picture.svg, f"{name}.png": picture.png}
    for name, content in files.items():
        write_atomic(folder / name, content)
    return [folder / name for name in sorted(files)]


def _more_tables(found: Explained) -> dict[str, str]:
    knock = found.knock_outs
    return {
        "knock_outs": table(list(vars(knock[0])), ([*vars(row).values()] for row in knock)),
        "sensitivities": table(
            [*vars(found.sensitivities[0]), "slope"],
            ([*vars(row).values(), row.slope] for row in found.sensitivities),
        ),
    }


def _pictures(found: Explained) -> Mapping[str, Picture]:
    verdict, tolerance = found.intact.verdict, found.course.parked.position_m
    intact = Outcome("intact", verdict.error_m, found.intact.total, verdict.parked)
    rows = [
        Outcome(
            f"neuron {row.name}" if row.kind == "neuron" else row.name, row.error_m, row.total, row.parked
        )
        for row in found.knock_outs
    ]
    deepest = sorted(found.sensitivities, key=lambda row: row.worst)[:SHOWN]
    bars = [
        Swing(f"{row.kind.replace('_', ' ')}, {row.name}", row.change_down, row.change_up) for row in deepest
    ]
    return {
        **pictures(found.analysis, found.course),
        "knock_outs": outcomes(rows, intact, tolerance, "The drive without each neuron and synapse"),
        "sensitivities": swings(bars, f"The return when a parameter moves by {STEP:.0%} of its range"),
    }


def _phase(told: Any) -> dict[str, Any]:
    phase = told.phase
    return {
        "label": phase.label,
        "start_s": phase.start_s,
        "end_s": phase.end_s,
        "driven_m": phase.driven_m,
        "turned_rad": phase.turned_rad,
        "motor": told.motor._asdict(),
        "rival": told.rival._asdict() if told.rival else None,
        "behind": told.behind._asdict() if told.behind else None,
        "by_leak": told.by_leak,
        "activity": told.activity,
        "pulls": [pull._asdict() for pull in told.pulls],
        "change": told.change._asdict() if told.change else None,
        "sentence": told.text,
    }


def _contribution(whole: Contribution, driving: Contribution) -> dict[str, Any]:
    paper = CONTRIBUTIONS.get((whole.source, whole.destination))
    return {
        **vars(whole),
        "driving": {name: getattr(driving, name) for name in ("sign", "positive", "negative")},
        "paper": paper,
    }


def _prose(found: Explained) -> str:
    return "\n".join(_lines(found)) + "\n"


def _lines(found: Explained) -> Iterator[str]:
    verdict = found.verdict
    ending = "parked" if verdict.parked else f"not parked: {verdict.reason}"
    yield f"# {found.policy.circuit.name} on {found.course.name}"
    yield ""
    yield f"{found.source}: {ending}; simulated return {found.intact.total:.4f}."
    yield ""
    for number, told in enumerate(found.analysis.explanations, 1):
        yield f"{number}. {told.text}"
    yield ""
    yield (
        "A pull is how far one synapse moves the potential its neuron is heading for, in mV, averaged over "
        "the phase."
    )
