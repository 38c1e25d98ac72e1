"""Runs as they are stored.

A results folder has one JSON-lines file for each budget and task, ``BUDGET/TASK.jsonl``, with a line
for each run, and a file ``BUDGET/TASK-AGENT-SEED.part`` for each search that has not ended.
"""

import json
import os
from collections.abc import Iterator
from enum import StrEnum
from pathlib import Path
from typing import Any, Self

import numpy as np
from pydantic import ConfigDict, ValidationError, model_validator

from paper.search import Point
from paper.tasks import GRADIENTS, TASKS, Vector
from rover_ncp.core.config import StrictModel
from rover_ncp.core.errors import FileError
from rover_ncp.core.files import read_text


class BudgetName(StrEnum):
    """Budget of a run, and the search that spends it. The help of ``run --budget`` describes them."""

    PUBLISHED = "published"
    ALGORITHM1 = "algorithm1"
    DEFAULT = "default"
    GRADIENTS = "gradients"
    QUICK = "quick"


class RunName(StrictModel):
    """Coordinates of a run in the grid."""

    task: str
    agent: str
    seed: int
    budget: BudgetName = BudgetName.PUBLISHED
    setting: tuple[float, float] | None = None
    """Alpha and the first sigma of Algorithm 1; None: those of ``sim.learn.search.algorithm1``."""

    def __str__(self) -> str:
        setting = "".join(f"-{number:g}" for number in self.setting or ())
        return f"{self.budget} {self.task} {self.agent}{setting} {self.seed}"


class Packed(StrictModel):
    """An array of float64 as its shape and its little-endian bytes in hexadecimal digits."""

    shape: tuple[int, ...]
    float64: str

    @model_validator(mode="after")
    def _can_be_unpacked(self) -> Self:
        self.array()
        return self

    @classmethod
    def of(cls, array: Vector) -> "Packed":
        """Pack an array."""
        return cls(shape=array.shape, float64=array.astype("<f8").tobytes().hex())

    def array(self) -> Vector:
        """Return the array."""
        return np.frombuffer(bytes.fromhex(self.float64), "<f8").astype(np.float64).reshape(self.shape)


class Score(StrictModel):
    """Returns of trained parameters in fresh episodes."""

    episodes: int
    mean: float
    std: float
    plain_mean: float
    success: bool


class Result(Score):
    """A finished run: its score and cost, and the trained parameters."""

    model_config = ConfigDict(extra="ignore")
    """Lines of other versions may say more."""

    name: RunName
    settings: dict[str, Any]
    made_with: dict[str, str]
    cpu_s: float
    steps: int
    """Of the environment, in all episodes."""
    curve: tuple[Point, ...]
    """Changes of the incumbent's estimate; of PPO and A2C none."""
    parameters: Packed
    """The trained vector (P,)."""

    @property
    def score(self) -> Score:
        """The score alone."""
        return Score(**self.model_dump(include=set(Score.model_fields)))

    def value_after(self, iterations: int) -> float:
        """Return the incumbent's estimate after so many iterations of a search."""
        return [value for count, _, value in self.curve if count <= iterations][-1]


class ResultStore:
    """The results in a folder, ``BUDGET/TASK.jsonl``. Of two runs of one name the last one counts."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._read: dict[Path, dict[RunName, Result]] = {}

    def path(self, task: str, budget: str) -> Path:
        """Return the file of a task and a budget."""
        return self.folder / budget / f"{task}.jsonl"

    def unfinished(self, name: RunName) -> Path:
        """Return the file of a search that has not ended."""
        return self.folder / name.budget / f"{str(name).partition(' ')[2].replace(' ', '-')}.part"

    def results(self, task: str, agent: str, budget: str | None = None) -> list[Result]:
        """Return the finished runs of an agent, by seed, without a budget those of the paper's search or of
        gradients. Raises FileError."""
        own = BudgetName.GRADIENTS if agent in GRADIENTS else BudgetName.PUBLISHED
        runs = self._runs(self.path(task, budget or own)).values()
        return sorted((run for run in runs if run.name.agent == agent), key=lambda run: run.name.seed)

    def every(self) -> Iterator[Result]:
        """Yield all runs, file by file. Raises FileError."""
        for budget in BudgetName:
            for path in sorted((self.folder / budget).glob("*.jsonl")):
                yield from self._runs(path).values()

    def save(self, result: Result) -> None:
        """Append a result to its file, after a line that was cut off too. Raises FileError."""
        path = self.path(result.name.task, result.name.budget)
        line = json.dumps(result.model_dump(), allow_nan=False) + "\n"
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            with path.open("a+b") as file:
                if file.seek(0, os.SEEK_END) and file.seek(-1, os.SEEK_END) and file.read(1) != b"\n":
                    line = f"\n{line}"
                file.write(line.encode())
                file.flush()
                os.fsync(file.fileno())
        except OSError as error:
            raise FileError(f"{path}: cannot be written: {error.strerror}") from error
        self._read.pop(path, None)

    def _runs(self, path: Path) -> dict[RunName, Result]:
        if path not in self._read:
            found = self._read[path] = {}
            for number, line in enumerate(read_text(path).splitlines() if path.is_file() else (), start=1):
                try:
                    result = Result.model_validate(json.loads(line))
                except (ValueError, ValidationError) as error:
                    raise FileError(f"{path}: line {number} is damaged or no run; delete the line") from error
                if self.path(result.name.task, result.name.budget) != path or path.stem not in TASKS:
                    raise FileError(f"{path}: line {number} is {result.name}, which belongs to another file")
                found[result.name] = result
        return self._read[path]
