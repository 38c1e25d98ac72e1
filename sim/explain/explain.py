"""Explanation of a circuit on a course: the findings about its run, and what-ifs.

The run is simulated or recorded; the what-ifs are always simulated.
"""

import shlex
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from deploy.view.findings import Findings, analyse
from deploy.view.recorded_drive import read_drive
from deploy.view.sentences import number
from deploy.view.trace import Trace
from rover_ncp.circuit.policy import Policy
from rover_ncp.circuit.policy_file import load_policy
from rover_ncp.course.course import Course, Verdict, load_course
from sim.explain.what_if import Knockout, Sensitivity, knock_outs, sensitivities
from sim.learn.engine.rollout import Rollout, rollout


@dataclass(frozen=True, eq=False)
class Explanation:
    """Result of ``rover-ncp explain``."""

    source: str
    command: str
    """That makes this."""
    policy: Policy
    course: Course
    verdict: Verdict
    """Verdict on the explained run."""
    intact: Rollout
    """The simulated run of the intact circuit, to which the what-ifs are compared."""
    findings: Findings
    knock_outs: tuple[Knockout, ...]
    sensitivities: tuple[Sensitivity, ...]

    @property
    def title(self) -> str:
        """What was explained."""
        return f"Policy {self.policy.circuit.name} on course {self.course.name}"

    @property
    def ending(self) -> str:
        """The run's end in words."""
        how = "parked" if self.verdict.parked else f"not parked: {self.verdict.reason}"
        return f"{how}; return in simulation {number(self.intact.total, 4)}"

    def fields(self) -> dict[str, Any]:
        """Return everything but the potentials as plain values."""
        findings = self.findings
        return {
            "source": self.source,  #: the argument
            "policy": self.policy.circuit.name,  #: its name
            "course": self.course.name,  #: its name
            "run": vars(self.verdict),  #: simulated or recorded
            "simulated": {"return": self.intact.total, "parked": self.intact.verdict.parked},
            **findings.fields((a, b) for b in findings.motors for a in findings.sources),
            "knock_outs": [vars(row) for row in self.knock_outs],
            "sensitivities": [{**vars(row), "slope": row.slope} for row in self.sensitivities],
        }


def explain(
    source: str,
    course: str | None = None,
    *,
    on_progress: Callable[[str], None] = lambda _: None,
) -> Explanation:
    """Explain a policy (name or file) on a course, or a recording (``.mcap``) on its own course.

    Raises FileError and ConfigError.
    """
    if Path(source).suffix == ".mcap":
        drive = read_drive(Path(source))
        policy, known = drive.policy, drive.course if course is None else load_course(course)
        intact = rollout(policy, known)
        trace, verdict = drive.timeline.trace(), next(iter(drive.timeline.judge().values()))
    else:
        policy, known = load_policy(source), load_course(course or "parking")
        intact = rollout(policy, known)
        trace, verdict = traced(policy, intact), intact.verdict
    return _explained(
        known,
        intact,
        trace,
        verdict,
        source=source,
        command=command_line(source, course=course),
        on_progress=on_progress,
    )


def command_line(source: str | None, **options: str | None) -> str:
    """Return the command that makes an explanation, without ``--out``."""
    words = ["rover-ncp", "explain", *([source] if source else [])]
    words += [word for name, value in options.items() if value for word in (f"--{name}", value)]
    return shlex.join(words)


def explain_stored(
    source: str,
    command: str,
    policy: Policy,
    *,
    on_progress: Callable[[str], None] = lambda _: None,
) -> Explanation:
    """Explain a stored circuit of the paper's parking tasks, as ``explain`` does a policy."""
    known = load_course("parking")
    intact = rollout(policy, known)
    trace = traced(policy, intact)
    return _explained(
        known,
        intact,
        trace,
        intact.verdict,
        source=source,
        command=command,
        on_progress=on_progress,
    )


def _explained(
    known: Course,
    intact: Rollout,
    trace: Trace,
    verdict: Verdict,
    *,
    source: str,
    command: str,
    on_progress: Callable[[str], None],
) -> Explanation:
    policy = trace.policy
    parts = policy.circuit.size + policy.circuit.synapse_count
    on_progress(f"driving the course without each of {parts} neurons and synapses")
    without = knock_outs(policy, known, intact)
    on_progress(f"moving each of {policy.layout().size} parameters a little")
    return Explanation(
        source=source,
        command=command,
        policy=policy,
        course=known,
        verdict=verdict,
        intact=intact,
        findings=analyse(trace),
        knock_outs=without,
        sensitivities=sensitivities(policy, known),
    )


def traced(policy: Policy, run: Rollout) -> Trace:
    """Return the trace of a simulated run."""
    return Trace(policy, run.times[:-1], run.poses, run.commands, run.potentials)
