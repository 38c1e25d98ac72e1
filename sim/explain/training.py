"""Report on a training run, read from its folder: curves, intermediate drives, final parameters.

The drives are simulated again here. The report of a run that continues, or was killed, covers it up to now.
"""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from markupsafe import escape
from numpy.typing import NDArray

from deploy.report.charts.animation import FORMATS, animate
from deploy.report.page.page import drive_page, fragment, page
from deploy.report.page.page_data import course_data
from deploy.report.recorded_drive import read_drive
from deploy.report.sentences import number
from rover_ncp.circuit.policy import Policy
from rover_ncp.circuit.policy_file import load_policy
from rover_ncp.core.config import load_yaml
from rover_ncp.core.errors import ConfigError, FileError, UsageError
from rover_ncp.core.files import existing_file, read_text, require_writable, write_atomic
from rover_ncp.course.course import Course
from sim.explain.what_if import parameter_names
from sim.learn.curve import curve_iterations
from sim.learn.record import Record, TaskSettings, TrainSettings
from sim.learn.rollout import Rollout, rollout
from sim.learn.run_folder import saved_settings

FloatArray = NDArray[np.float64]

LEAST_LOSS = 1e-4
"""Smaller losses are drawn here: the axis is logarithmic."""
BINS = 24
"""Of a histogram of parameters."""


@dataclass(frozen=True, eq=False)
class Agent:
    """One agent as it was saved last."""

    number: int
    iterations: int
    improvements: tuple[tuple[int, float], ...]
    """(iteration, return) at each rise of its best return."""
    parameters: FloatArray
    run: Rollout

    def value_at(self, iteration: int) -> float:
        """Return its best return after an iteration."""
        return [value for at, value in self.improvements if at <= iteration][-1]

    @property
    def best(self) -> float:
        """Its best return."""
        return self.improvements[-1][1]


@dataclass(frozen=True, eq=False)
class Milestone:
    """The best policy after some iterations, and its drive."""

    iterations: int
    run: Rollout


@dataclass(frozen=True, eq=False)
class Training:
    """A training run: its agents by number, and its milestones in order, the last one from now."""

    record: Record[TrainSettings]
    course: Course
    policy: Policy
    agents: tuple[Agent, ...]
    milestones: tuple[Milestone, ...]

    @property
    def iterations(self) -> int:
        """Iterations that all agents have made."""
        return min(agent.iterations for agent in self.agents)

    @property
    def best(self) -> Agent:
        """The agent of the highest return."""
        return max(self.agents, key=lambda agent: (agent.best, -agent.number))


class Page(NamedTuple):
    """A page that was written; ``kind`` is drive or training."""

    path: Path
    kind: str
    size: int


def read_training(folder: Path) -> Training:
    """Read the folder of ``rover-ncp train``. Raises FileError and ConfigError."""
    if not (folder / "settings.yaml").is_file():
        raise FileError(f"{folder}: holds no training run (no settings.yaml)")
    settings = saved_settings(folder)
    if not isinstance(settings, TrainSettings):
        on = (
            f"--task {settings.task}" if isinstance(settings, TaskSettings) else f"--course {settings.course}"
        )
        raise UsageError(
            f"{folder}: no page for a training with --task or --randomize; {folder / 'curve.csv'} has its "
            f"costs, and rover-ncp explain {folder / 'policy.yaml'} {on} explains its policy"
        )
    record = load_yaml(folder / "settings.yaml", Record[TrainSettings])
    course = Course.model_validate(record.course)
    files = sorted((folder / "agents").glob("*.json"))
    if not files or not (folder / "policy.yaml").is_file():
        raise FileError(f"{folder}: the training has not saved anything yet")
    policy = load_policy(folder / "policy.yaml")
    agents = tuple(_agent(path, policy, course) for path in files)
    milestones = []
    for path in sorted((folder / "milestones").glob("[0-9]*.yaml")):
        if not path.stem.isdigit():
            raise FileError(f"{path}: a milestone is named for its iterations")
        milestones.append(Milestone(int(path.stem), rollout(load_policy(path), course)))
    last = min(agent.iterations for agent in agents)
    if not milestones or milestones[-1].iterations < last:
        milestones.append(Milestone(last, rollout(policy, course)))
    return Training(record, course, policy, agents, tuple(milestones))


def _agent(path: Path, policy: Policy, course: Course) -> Agent:
    try:
        data: Any = json.loads(read_text(path))
        parameters = np.array(data["search"]["incumbent"], np.float64)
        return Agent(
            number=int(data["agent"]),
            iterations=max(int(data["search"]["evaluations"]) - 1, 0),
            improvements=tuple((int(at), float(value)) for at, value in data["improvements"]),
            parameters=parameters,
            run=rollout(policy.with_parameters(parameters), course),
        )
    except (ValueError, KeyError, TypeError, ConfigError) as error:
        raise FileError(f"{path}: damaged, or not an agent of this run") from error


def write_page(source: Path, out: Path | None = None) -> Page:
    """Write the report of a recording beside it, or of a training run into its folder.

    Raises FileError and ConfigError.
    """
    if source.is_dir():
        kind, path = "training", out or source / "report.html"
    else:
        kind, path = "drive", out or existing_file(source).with_suffix(".html")
    require_writable(path)
    text = training_page(read_training(source)) if kind == "training" else drive_page(read_drive(source))
    write_atomic(path, text)
    return Page(path, kind, len(text.encode()))


def write_animation(source: Path, out: Path) -> None:
    """Write a recorded drive as an animated picture. Raises FileError, ConfigError and UsageError."""
    if out.suffix not in FORMATS:
        raise UsageError(f"--animation {out}: expected a file that ends in {' or '.join(FORMATS)}")
    if source.is_dir():
        raise UsageError(f"--animation needs the recording of a drive; {source} is a folder")
    require_writable(out)
    drive = read_drive(source)
    write_atomic(out, animate(drive.timeline.trace(), drive.course, out.suffix))


def training_page(training: Training) -> str:
    """Return the page of a training run as HTML."""
    record, best = training.record, training.best
    settings, verdict = record.settings, best.run.verdict
    badge, kind = ("Parks", "good") if verdict.parked else ("Does not park yet", "bad")
    words = f"agent {best.number:02}, return {number(best.best, 4)}"
    words += f", {1000 * verdict.error_m:.0f} mm from the goal"
    return page(
        "training.html",
        title=f"{badge}: {words} ({settings.course})",
        data=training_data(training),
        html={
            "title": fragment("title", badge, kind, words),
            "subline": escape(
                f"{settings.agents} agents, {settings.search} search, {training.iterations} of "
                f"{settings.iterations} iterations, course {training.course.name}, seed {settings.seed}"
            ),
        },
        agents=sorted(training.agents, key=lambda agent: -agent.best),
        origin=[
            ("Command", record.command),
            ("Made with", ", ".join(f"{name} {version}" for name, version in record.made_with.items())),
        ],
    )


def training_data(training: Training) -> dict[str, Any]:
    """Return the data of the page's charts as plain values."""
    iterations = curve_iterations(training.iterations)
    losses = -np.array([[agent.value_at(i) for i in iterations] for agent in training.agents])
    losses = np.maximum(losses, LEAST_LOSS)
    return {
        "course": course_data(training.course),
        "curves": {
            "iterations": iterations,
            "losses": losses.round(5).tolist(),
            "quartiles": np.percentile(losses, [25, 50, 75], axis=0).round(5).tolist(),
            "best": training.agents.index(training.best),
        },
        "agents": [_path(agent.run) for agent in training.agents],
        "milestones": [
            {
                "iterations": milestone.iterations,
                "value": round(milestone.run.total, 5),
                "parked": milestone.run.verdict.parked,
                **_path(milestone.run),
            }
            for milestone in training.milestones
        ],
        "parameters": _parameters(training),
    }


def _path(run: Rollout) -> dict[str, Any]:
    return {name: run.poses[:, column].round(5).tolist() for column, name in enumerate("xy")}


def _parameters(training: Training) -> list[dict[str, Any]]:
    """Return, for each kind of parameter, a histogram of all values and the best agent's values by name."""
    names = parameter_names(training.policy)
    found = []
    for kind, block, lower, upper in training.policy.layout().blocks:
        values = np.array([agent.parameters[block] for agent in training.agents])
        found.append(
            {
                "kind": str(kind).replace("_", " "),
                "lower": lower,
                "upper": upper,
                "counts": np.histogram(values, BINS, (lower, upper))[0].tolist(),
                "at_bounds": float(np.mean((values <= lower) | (values >= upper))),
                "best": training.best.parameters[block].round(5).tolist(),
                "names": [name for _, name in names[block]],
            }
        )
    return found
