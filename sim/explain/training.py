"""Report on a training run, read from its folder: curves, intermediate drives, final parameters.

The drives are simulated again here. A run that still goes on, or was killed, is reported as far as it got.
"""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rover_ncp.circuit.policy import Policy
from rover_ncp.circuit.policy_file import load_policy
from rover_ncp.core.config import load_yaml
from rover_ncp.core.errors import ConfigError, FileError
from rover_ncp.core.files import read_text
from rover_ncp.course.course import Course
from sim.explain.sensitivity import parameter_names
from sim.learn.curve import curve_iterations
from sim.learn.record import Record, TrainSettings
from sim.learn.rollout import Rollout, rollout

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Agent:
    """One agent as it was saved last."""

    number: int
    iterations: int
    improvements: tuple[tuple[int, float], ...]
    """(iteration, return) wherever its best return rose."""
    parameters: FloatArray
    run: Rollout

    def value_at(self, iteration: int) -> float:
        """Return its best return after an iteration."""
        return [value for at, value in self.improvements if at <= iteration][-1]


@dataclass(frozen=True, eq=False)
class Milestone:
    """The best policy after some iterations, and its drive."""

    iterations: int
    run: Rollout


@dataclass(frozen=True, eq=False)
class Training:
    """A training run; agents by number, milestones in order, the last one as it stands now."""

    record: Record[TrainSettings]
    course: Course
    policy: Policy
    agents: tuple[Agent, ...]
    milestones: tuple[Milestone, ...]

    @property
    def best(self) -> Agent:
        """The agent of the highest return."""
        return max(self.agents, key=lambda agent: (agent.value_at(agent.iterations), -agent.number))


def read_training(folder: Path) -> Training:
    """Read the folder of ``rover-ncp train``. Raises FileError and ConfigError."""
    settings = folder / "settings.yaml"
    if not settings.is_file():
        raise FileError(f"{folder}: holds no training run (no settings.yaml)")
    record = load_yaml(settings, Record)
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


def training_data(training: Training) -> dict[str, Any]:
    """Return what the page of a training shows, as plain values."""
    last = min(agent.iterations for agent in training.agents)
    iterations = curve_iterations(last)
    best, settings = training.best, training.record.settings
    return {
        "subline": (
            f"{settings.agents} agents, {settings.search} search, {last} of {settings.iterations} "
            f"iterations, course {training.course.name}, seed {settings.seed}"
        ),
        "parked": best.run.verdict.parked,
        "headline": _headline(best),
        "curves": {
            "iterations": iterations,
            "agents": [
                [_digits(agent.value_at(iteration)) for iteration in iterations] for agent in training.agents
            ],
            "numbers": [agent.number for agent in training.agents],
            "best": training.agents.index(best),
        },
        "agents": [
            {
                "number": agent.number,
                "value": _digits(agent.value_at(agent.iterations)),
                "parked": agent.run.verdict.parked,
                "reason": agent.run.verdict.reason,
                "errorM": _digits(agent.run.verdict.error_m),
                "errorRad": _digits(agent.run.verdict.error_rad),
                "last": agent.improvements[-1][0],
                **_way(agent.run),
            }
            for agent in training.agents
        ],
        "milestones": [
            {
                "iterations": milestone.iterations,
                "value": _digits(milestone.run.total),
                "parked": milestone.run.verdict.parked,
                **_way(milestone.run),
            }
            for milestone in training.milestones
        ],
        "parameters": _parameters(training),
        "origin": [
            ["Command", training.record.command],
            ["Made with", ", ".join(f"{name} {v}" for name, v in training.record.made_with.items())],
        ],
    }


def _headline(best: Agent) -> str:
    verdict, value = best.run.verdict, best.value_at(best.iterations)
    number = f"{value:.4f}".replace("-", "−")
    ending = "Parks" if verdict.parked else "Does not park yet"
    return f"{ending}: agent {best.number:02}, return {number}, {1000 * verdict.error_m:.0f} mm from the goal"


def _way(run: Rollout) -> dict[str, Any]:
    return {"x": [_digits(x) for x in run.poses[:, 0]], "y": [_digits(y) for y in run.poses[:, 1]]}


def _parameters(training: Training) -> list[dict[str, Any]]:
    """Return, by kind, every agent's values against the bounds, and who owns them."""
    layout, names = training.policy.layout(), parameter_names(training.policy)
    every = np.array([agent.parameters for agent in training.agents])
    best = training.agents.index(training.best)
    return [
        {
            "kind": str(block.kind).replace("_", " "),
            "lower": block.lower,
            "upper": block.upper,
            "names": [name for _, name in names[block.slice]],
            "values": [[_digits(value) for value in row] for row in every[:, block.slice]],
            "best": best,
        }
        for block in layout.blocks
    ]


def _digits(value: float) -> float:
    return round(float(value), 5)
