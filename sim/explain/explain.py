"""Explanation of a circuit on a course: the findings about one drive, and what-ifs.

The drive is simulated or recorded. The what-ifs are always simulated.
"""

import shlex
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from deploy.view.recorded_drive import read_drive
from rover_ncp.circuit.policy import Policy
from rover_ncp.circuit.policy_file import load_policy
from rover_ncp.core.config import ResultModel
from rover_ncp.core.errors import UsageError
from rover_ncp.course.course import Course, load_course
from rover_ncp.course.scoring import Parked, Verdict
from rover_ncp.native.core import required
from rover_ncp.neurons.findings import Findings, analyse, number
from rover_ncp.neurons.interpretation import Contribution, Interpretation, TimeConstant, interpret
from rover_ncp.neurons.phases import ExplainedPhase
from rover_ncp.neurons.trace import Trace
from rover_ncp.robot.description import RobotDescription
from sim.explain.what_if import Knockout, Sensitivity, knock_outs, sensitivities
from sim.learn.evaluator import Evaluator
from sim.learn.rollout import Rollout, rollout
from sim.world.described import described_rover

FloatArray = NDArray[np.float64]
Progress = Callable[[str], None]


class Simulated(ResultModel):
    """The intact circuit in simulation."""

    total: float = Field(serialization_alias="return")
    """of the drive"""
    parked: bool
    """whether it parks"""


@dataclass(frozen=True, eq=False)
class Explanation:
    """Result of ``rover-ncp explain``."""

    source: str
    command: str
    """The command that makes this, without ``--out``."""
    course: Course
    verdict: Verdict
    """Verdict on the explained drive, simulated or recorded."""
    simulated: Simulated
    """Result of the whole circuit, to which the what-ifs are compared."""
    findings: Findings
    interpretation: Interpretation
    knock_outs: tuple[Knockout, ...]
    sensitivities: tuple[Sensitivity, ...]
    robot: RobotDescription | None = None
    """The simulated robot; None for the default one."""

    @property
    def policy(self) -> Policy:
        """The explained policy."""
        return self.findings.trace.policy

    @property
    def title(self) -> str:
        """Names of policy and course."""
        return f"Policy {self.policy.circuit.name} on course {self.course.name}"

    @property
    def ending(self) -> str:
        """The drive's end in words."""
        reason = self.verdict.reason and f": {self.verdict.reason}"
        robot = self.robot and f" of {self.robot.name}"
        return (
            f"{self.verdict.words}{reason}; return in simulation{robot or ''} {number(self.simulated.total)}"
        )

    def result(self, files: Sequence[Path] = ()) -> "Result":
        """Return everything but the potentials, with the files that were written."""
        found = self.interpretation
        return Result(
            source=self.source,
            policy=self.policy.circuit.name,
            course=self.course.name,
            run=self.verdict,
            verdict=self.verdict.words,
            simulated=self.simulated,
            phases=self.findings.phases,
            contributions=tuple(found.contributions[a, b] for b in found.motors for a in found.sources),
            time_constants=found.time_constants,
            knock_outs=self.knock_outs,
            sensitivities=self.sensitivities,
            files=tuple(map(str, files)),
        )


class Result(ResultModel):
    """What ``rover-ncp explain`` prints."""

    source: str
    """the argument"""
    policy: str
    """its name"""
    course: str
    """its name"""
    run: Verdict
    """the explained drive, simulated or recorded"""
    verdict: Parked
    """on that drive: parked, 'parked, uncertain' or not parked"""
    simulated: Simulated
    """the intact circuit"""
    phases: tuple[ExplainedPhase, ...]
    """of the manoeuvre, in order"""
    contributions: tuple[Contribution, ...]
    """of sensory, inter and command neurons to motor neurons"""
    time_constants: tuple[TimeConstant, ...]
    """in the run"""
    knock_outs: tuple[Knockout, ...]
    """drives without a neuron or a synapse"""
    sensitivities: tuple[Sensitivity, ...]
    """of the return to each parameter"""
    files: tuple[str, ...]
    """that were written"""


def explain(
    source: str | Path, course: str | None = None, *, on_progress: Progress = lambda _: None
) -> Explanation:
    """Explain a policy (name or file) on a course, or a recording (``.mcap``) on its own course and robot.

    Raises UsageError for the recording of a docking or a recording with a course, and without the native
    library; FileError and ConfigError.
    """
    required()
    source = str(source)
    command = command_line(source, course)
    if Path(source).suffix.lower() != ".mcap":
        policy, known = load_policy(source), load_course(course or "parking")
        return explain_drive(source, command, policy, known, on_progress=on_progress)
    if course is not None:
        raise UsageError(f"--course {course}: does not go with a recording, which has its own course")
    drive = read_drive(Path(source))
    if drive.docks:
        raise UsageError(
            f"{source}: the recording of a docking, which has no course to simulate; "
            f"'rover-ncp report {source}' explains it"
        )
    recorded = drive.timeline.traces()[0], next(iter(drive.timeline.judge().values()))
    return explain_drive(
        source, command, drive.policy, drive.course, recorded, on_progress=on_progress, robot=drive.robot
    )


def command_line(source: str, course: str | None) -> str:
    """Return the command that makes an explanation, without ``--out``."""
    return shlex.join(["rover-ncp", "explain", source, *(["--course", course] if course else [])])


def explain_drive(
    source: str,
    command: str,
    policy: Policy,
    course: Course,
    recorded: tuple[Trace, Verdict] | None = None,
    *,
    on_progress: Progress = lambda _: None,
    robot: RobotDescription | None = None,
) -> Explanation:
    """Explain a policy's recorded drive, or its simulated one; ``robot`` is the simulated one."""
    model = described_rover(robot) if robot else None
    run = rollout(policy, course, model)
    trace, verdict = recorded or (traced(policy, run), run.verdict)

    def simulate(other: Policy) -> Rollout:
        return rollout(other, course, model)

    parts = policy.circuit.size + policy.circuit.synapse_count
    on_progress(f"simulating without each of {parts} neurons and synapses")
    without = knock_outs(policy, simulate, run.total)
    on_progress(f"moving each of {policy.layout().size} parameters a little")
    findings = analyse(trace)
    return Explanation(
        source=source,
        command=command,
        course=course,
        verdict=verdict,
        simulated=Simulated(total=run.total, parked=run.verdict.parked),
        findings=findings,
        interpretation=interpret(trace, findings.phases),
        knock_outs=without,
        sensitivities=sensitivities(policy, Evaluator(policy, course, model).returns),
        robot=robot,
    )


def traced(policy: Policy, run: Rollout) -> Trace:
    """Return the trace of a simulated run."""
    return Trace(policy, run.times[:-1], run.poses, run.commands, run.potentials)
