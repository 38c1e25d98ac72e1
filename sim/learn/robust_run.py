"""A robust training from settings to files: what ``rover-ncp train --randomize`` does.

policy.yaml        the mean of the search, with the command that makes it again
curve.csv          generation, best cost in it, spread of the search
settings.yaml      what was asked for
"""

import shlex
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

from pydantic import Field

from rover_ncp.circuit.policy import Policy, course_policy
from rover_ncp.circuit.policy_file import load_circuit, save_policy
from rover_ncp.core.config import StrictModel, dump_yaml
from rover_ncp.core.course import load_course
from rover_ncp.core.errors import UsageError
from rover_ncp.core.files import write_atomic
from rover_ncp.core.reference import plan_reference
from sim.learn.engine import Engine
from sim.learn.record import made_with
from sim.learn.robust import Generation, UnitCube, robust_search, training_courses
from sim.world.randomization import draw_trials, load_randomization
from sim.world.rover import RoverModel

__all__ = ["RobustResult", "RobustSettings", "train_robust"]

_SAVE_EVERY = 25


class RobustSettings(StrictModel):
    """What decides a robust training's result."""

    course: str = "parking"
    circuit: str = "tracking"
    randomize: str = "full"
    seed: int = Field(default=0, ge=0)
    iterations: int = Field(default=1000, ge=1, description="generations")
    rollouts: int = Field(default=64, ge=1, description="trials of a candidate")
    worst: int = Field(default=64, ge=1, description="of which so many worst are averaged")
    random_courses: int = Field(default=24, ge=0, description="that are driven beside the course")

    def command(self) -> str:
        """Return the command line that makes the same circuit again."""
        options = [
            part
            for name, value in self.model_dump().items()
            for part in (f"--{name.replace('_', '-')}", str(value))
        ]
        return shlex.join(["rover-ncp", "train", *options])


class RobustResult(NamedTuple):
    """The trained policy, its file, and where the search stood at the end."""

    policy: Policy
    path: Path
    last: Generation


def train_robust(
    settings: RobustSettings, out: Path, on_generation: Callable[[Generation], None] = lambda _: None
) -> RobustResult:
    """Train a course-relative circuit and leave it in the folder ``out``, which must be empty or missing.

    Interrupted, it leaves what it has. Raises UsageError, ConfigError or FileError.
    """
    if settings.worst > settings.rollouts:
        raise UsageError(f"the worst {settings.worst} of {settings.rollouts} rollouts cannot be taken")
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise UsageError(f"{out}: is not an empty folder")
    model, course = RoverModel(), load_course(settings.course)
    start = course_policy(load_circuit(settings.circuit))
    ranges = load_randomization(settings.randomize)
    courses, references = training_courses(
        course, plan_reference(course), settings.seed, settings.random_courses
    )
    ticks = max(each.ticks for each in courses)
    nothing_yet = draw_trials(ranges, model, settings.seed, count=1, ticks=ticks)
    engine = Engine(start, courses, model, nothing_yet, references)
    names = (course.name, *(["random"] if settings.random_courses else []))
    origin: dict[str, Any] = {
        "command": settings.command(),
        "settings": settings.model_dump(),
        "made_with": made_with(),
    }
    curve = ["generation,cost,spread"]
    path = out / "policy.yaml"
    write_atomic(out / "settings.yaml", dump_yaml(origin))

    def save(last: Generation) -> Policy:
        done = origin | {"generation": last.number, "cost": last.best}
        policy = replace(start.with_parameters(last.mean), courses=names, provenance=done)
        save_policy(path, policy)
        write_atomic(out / "curve.csv", "\n".join([*curve, ""]))
        return policy

    for last in robust_search(
        engine,
        UnitCube(start),
        ranges,
        seed=settings.seed,
        generations=settings.iterations,
        rollouts=settings.rollouts,
        worst=settings.worst,
        model=model,
    ):
        curve.append(f"{last.number},{last.best!r},{last.spread!r}")
        on_generation(last)
        if last.number % _SAVE_EVERY == 0:
            save(last)
    return RobustResult(save(last), path, last)
