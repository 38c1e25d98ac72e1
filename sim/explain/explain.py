"""Everything about one circuit on one course: its run read, and what becomes of it when parts are missing.

The run is a simulated one, or one that was recorded; the what-ifs are always simulated.
"""

from collections.abc import Callable, Mapping
from pathlib import Path

from deploy.report.analysis import analyse
from deploy.report.charts.bars import Outcome, Swing, outcomes, swings
from deploy.report.charts.figure import Picture
from deploy.report.charts.files import pictures, table, tables
from deploy.report.interpretation import THRESHOLD
from deploy.report.recorded_drive import judge, read_drive
from deploy.report.trace import Trace
from rover_ncp.circuit.policy import Policy
from rover_ncp.circuit.policy_file import load_policy
from rover_ncp.core.files import write_atomic
from rover_ncp.course.course import load_course
from sim.explain.explained import Explained
from sim.explain.knockout import knock_outs
from sim.explain.prose import prose
from sim.explain.sensitivity import STEP, sensitivities
from sim.learn.rollout import Rollout, rollout

SHOWN = 25
"""Parameters in the picture of sensitivities."""


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
    files: dict[str, bytes | str] = {"explanation.md": prose(found)}
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
