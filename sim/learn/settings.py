"""Record of a training run: its settings, the content of the files they name, and the software versions.

The record is written before the first iteration and never changes. All that ends up in a policy's
provenance comes from it, so that a run that was killed and resumed ends in the same bytes.
"""

import platform
import shlex
import subprocess
from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Any, Literal, NamedTuple, Self, TypeAlias

import yaml
from pydantic import Field, model_validator

from rover_ncp.circuit.policy import Policy, absolute_policy, course_policy
from rover_ncp.circuit.policy_file import circuit_to_yaml, load_start, policy_data
from rover_ncp.circuit.rover_interface import RoverInterface
from rover_ncp.core.config import StrictModel, dump_yaml
from rover_ncp.core.errors import ConfigError, UsageError
from rover_ncp.course.course import Course, load_course
from rover_ncp.course.slowdown import slowed
from rover_ncp.robot.description import RobotDescription, load_description
from sim.learn.search import SearchName
from sim.world.described import default_rover, described_rover, ranges_for
from sim.world.pymunk_rover import require_free_start
from sim.world.randomization import Randomization
from sim.world.rover import RoverModel

_LIBRARIES = ("rover-ncp", "numpy", "scipy", "pymunk")
_GIT_TIMEOUT_S = 5.0
_FILES = ("course", "circuit", "model", "randomize", "profile")
"""Settings that name a file; a record has the file's content by the same name."""


class _Settings(StrictModel):
    course: str = Field(default="parking", description="its name")
    model: str | None = Field(
        default=None, exclude_if=lambda name: name is None, description="the robot, if it is not a 3-AT"
    )

    def command(self) -> str:
        """Return the command line that makes the same circuits again."""
        options = [
            part
            for name, value in self.model_dump().items()
            for part in (f"--{name.replace('_', '-')}", *([] if value is True else [str(value)]))
        ]
        return shlex.join(["rover-ncp", "train", *options])


class TrainSettings(_Settings):
    """Settings that decide a training run's result; the number of processes does not."""

    circuit: str = "parking"
    seed: int = Field(default=0, ge=0)
    agents: int = Field(default=12, ge=1, le=1000)
    iterations: int = Field(default=20_000, ge=1)
    search: SearchName = "gauss-newton"


class RobustSettings(_Settings):
    """Settings that decide the result of a training on random trials."""

    circuit: str = Field(default="tracking", description="its name")
    randomize: str = Field(default="full", description="the ranges of the rovers")
    seed: int = Field(default=0, ge=0, description="of random numbers")
    iterations: int = Field(default=2600, ge=1, description="generations")
    rollouts: int = Field(default=144, ge=1, description="trials of a candidate")
    worst: int = Field(default=144, ge=1, description="number of worst rollouts in the average")
    random_courses: int = Field(default=400, ge=0, description="random courses beside the given one")
    profile: str | None = Field(
        default=None, exclude_if=lambda path: path is None, description="rover profile"
    )
    refine: bool = Field(
        default=False,
        exclude_if=lambda refine: not refine,
        description="whether the start was trained before",
    )

    @model_validator(mode="before")
    @classmethod
    def _all_rollouts(cls, data: Any) -> Any:
        if isinstance(data, dict) and "rollouts" in data:
            return {"worst": data["rollouts"], **data}
        return data

    @model_validator(mode="after")
    def _possible(self) -> Self:
        if self.worst > self.rollouts:
            raise ValueError(f"the worst {self.worst} of {self.rollouts} rollouts cannot be taken")
        return self


Settings: TypeAlias = TrainSettings | RobustSettings


class Task(NamedTuple):
    """Content of the files that the settings of a run name."""

    course: Course
    """As slow as the robot asks for."""
    policy: Policy
    """Its parameters are the start of the search."""
    robot: RobotDescription | None
    """None for the 3-AT."""
    ranges: Randomization | None
    """Ranges of the trials, with the profile; None for a training without random trials."""

    @property
    def rover(self) -> RoverModel:
        """The simulated robot."""
        return default_rover() if self.robot is None else described_rover(self.robot)


def load_task(settings: Settings) -> Task:
    """Load what the settings name.

    Raises UsageError, FileError or ConfigError, also for a circuit that cannot drive and a course that cannot
    begin.
    """
    robot = None if settings.model is None else load_description(settings.model)
    course, start, ranges = load_course(settings.course), load_start(settings.circuit), None
    if robot is not None:
        course = slowed(course, robot)[0]
    courses = [course.name]
    if isinstance(settings, RobustSettings):
        ranges = ranges_for(settings.randomize, Path(settings.profile) if settings.profile else None)
        courses += ["random"] if settings.random_courses else []
        if settings.refine and not isinstance(start, Policy):
            raise UsageError(
                f"--refine needs a policy in --circuit, and {settings.circuit} is an untrained circuit"
            )
    if isinstance(start, Policy):
        policy = start
    else:
        policy = absolute_policy(start, course) if ranges is None else course_policy(start)
    task = Task(course, replace(policy, courses=tuple(courses)), robot, ranges)
    RoverInterface(task.policy)  # raises for a policy that drives none
    require_free_start(task.rover, course)
    return task


class Record(StrictModel):
    """The file ``settings.yaml`` of a run: everything that was asked for, resolved."""

    format: Literal[1] = 1
    command: str
    settings: TrainSettings | RobustSettings
    made_with: dict[str, str]
    course: dict[str, Any]
    circuit: dict[str, Any]
    model: dict[str, Any] | None = Field(default=None, exclude_if=lambda model: model is None)
    """The robot's description, if the settings name one."""
    randomize: dict[str, Any] | None = Field(default=None, exclude_if=lambda ranges: ranges is None)
    """The ranges of a training on random trials, without the profile."""
    profile: dict[str, Any] | None = Field(default=None, exclude_if=lambda profile: profile is None)

    @classmethod
    def of(cls, settings: Settings, task: Task) -> Self:
        """Record a run that starts now."""
        start = load_start(settings.circuit)
        text = dump_yaml(policy_data(start)) if isinstance(start, Policy) else circuit_to_yaml(start)
        return cls(
            command=settings.command(),
            settings=settings,
            made_with=made_with(),
            course=task.course.model_dump(mode="json"),
            circuit=yaml.safe_load(text),
            model=_content(task.robot, "sources"),
            randomize=_content(task.ranges, "rover"),
            profile=_content(task.ranges.rover if task.ranges else None),
        )

    def require_same(self, other: "Record", source: str) -> None:
        """Raise ConfigError, naming every difference, unless ``other`` asks for the run recorded here."""
        saved, asked = self.settings.model_dump(), other.settings.model_dump()
        problems = [
            f"--{name} was {saved.get(name)} when this run began, now {asked.get(name)}"
            for name in {**saved, **asked}
            if saved.get(name) != asked.get(name)
        ]
        problems = problems or [
            f"--{name} {asked[name]}: the file has changed since this run began"
            for name in _FILES
            if getattr(self, name) != getattr(other, name)
        ]
        if problems:
            raise ConfigError(source, problems)

    def provenance(self, iterations: int, **found: float) -> dict[str, Any]:
        """Return how a policy came about that was ``found`` so, with the command that makes it again."""
        settings = self.settings.model_copy(update={"iterations": iterations})
        return {
            "command": settings.command(),
            **found,
            "settings": settings.model_dump(),
            "made_with": self.made_with,
        }


def _content(file: StrictModel | None, *without: str) -> dict[str, Any] | None:
    """Return the content of a file; a default is left out, so that a later version may add one."""
    if file is None:
        return None
    return file.model_dump(mode="json", exclude_defaults=True, exclude=set(without))


@cache
def versions() -> Mapping[str, str]:
    """Return the versions of what decides a result."""
    return {"python": platform.python_version()} | {name: metadata.version(name) for name in _LIBRARIES}


def made_with() -> dict[str, str]:
    """Return the versions of what decides a result, and the source's commit where there is one."""
    commit = _commit()
    return {**versions(), **({"commit": commit} if commit else {})}


def _commit() -> str | None:
    """Return the commit of the source that runs, with -dirty after local changes; None outside of git."""
    here = Path(__file__)
    git = ["git", "--no-optional-locks", "-C", str(here.parent)]
    try:
        # An environment may lie inside another repository without being part of it.
        _run([*git, "ls-files", "--error-unmatch", here.name])
        return _run([*git, "describe", "--always", "--dirty", "--abbrev=40", "--exclude=*"])
    except (OSError, subprocess.SubprocessError):
        return None


def _run(command: list[str]) -> str:
    done = subprocess.run(command, capture_output=True, text=True, timeout=_GIT_TIMEOUT_S, check=True)
    return done.stdout.strip()
