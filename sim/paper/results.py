"""Results of runs as files: settings, scores, and the trained parameters.

A file is written once, whole, when its run ends. ``replay`` (``runs.py``) scores its parameters again.
"""

import json
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import ValidationError

from rover_ncp.core.config import StrictModel
from rover_ncp.core.errors import FileError
from rover_ncp.core.files import read_text, write_atomic
from sim.learn.search.base import Vector
from sim.paper import BudgetName

SHIPPED = Path(__file__).parent / "results"


class RunName(StrictModel):
    """Coordinates of a run in the grid."""

    task: str
    agent: str
    seed: int
    budget: BudgetName = BudgetName.DEFAULT

    def path(self, folder: Path) -> Path:
        """Return a run's file in a folder."""
        return _column(folder, self.budget) / self.task / f"{self.agent}-{self.seed:02}.json"

    def __str__(self) -> str:
        return f"{self.task} {self.agent} {self.seed}"


def _column(folder: Path, budget: BudgetName) -> Path:
    """Return the place of a budget's runs; those of the default lie in the folder itself."""
    return folder if budget is BudgetName.DEFAULT else folder / budget


class Packed(StrictModel):
    """An array of float64 as its shape and its little-endian bytes in hexadecimal digits."""

    shape: tuple[int, ...]
    float64: str

    @classmethod
    def of(cls, array: Vector) -> "Packed":
        """Pack an array."""
        return cls(shape=array.shape, float64=array.astype("<f8").tobytes().hex())

    def array(self) -> Vector:
        """Return the array. Raises ValueError where shape and digits do not fit."""
        return np.frombuffer(bytes.fromhex(self.float64), "<f8").astype(np.float64).reshape(self.shape)


class Result(StrictModel):
    """A run that has ended."""

    format: Literal[1] = 1
    name: RunName
    command: str
    budget: str
    settings: dict[str, Any]
    made_with: dict[str, str]
    wall_s: float
    cpu_s: float
    evaluations: int
    steps: int
    """Environment steps of all episodes together."""
    ended: str
    """By enough, plateau, steps or evaluations."""
    curve: tuple[tuple[int, float], ...]
    """(steps, estimate of the incumbent), thinned; (iterations, estimate) with the paper's own searches."""
    episodes: int
    """Fresh episodes behind the next four fields."""
    mean: float
    """Return, with bonus where the task has one."""
    std: float
    plain_mean: float
    """Gymnasium's return."""
    success: bool
    circuit: str | None = None
    """The wiring, where a file gave it, as the text of a circuit file."""
    parameters: Packed
    """The trained vector (P,)."""


def load_result(path: Path) -> Result:
    """Read a run's file. Raises FileError for a damaged one."""
    try:
        return Result.model_validate(json.loads(read_text(path)))
    except (ValueError, ValidationError) as error:
        raise FileError(f"{path}: damaged, or not a run of the paper's grid; delete it to redo it") from error


class ResultStore:
    """Results on disk: the user's folder, and behind it the shipped ones."""

    def __init__(self, own: Path, shipped: Path | None = SHIPPED) -> None:
        self.own, self.shipped = own, shipped

    def find(self, name: RunName) -> Path | None:
        """Return a run's file, the user's before the shipped one; None if there is none."""
        for folder in (self.own, self.shipped):
            if folder is not None and name.path(folder).is_file():
                return name.path(folder)
        return None

    def unfinished(self, name: RunName) -> Path:
        """Return the file of a run's state before its end, in the user's folder."""
        return name.path(self.own).with_suffix(".partial")

    def save(self, result: Result) -> None:
        """Write a result into the user's folder. Raises FileError."""
        write_atomic(result.name.path(self.own), json.dumps(result.model_dump(), allow_nan=False) + "\n")

    def results(self, task: str, agent: str, budget: BudgetName = BudgetName.DEFAULT) -> list[Result]:
        """Return the runs that came to their end, by seed. Raises FileError."""
        paths: dict[str, Path] = {}
        for folder in (self.shipped, self.own):
            if folder is not None:
                files = (_column(folder, budget) / task).glob(f"{agent}-[0-9]*.json")
                paths |= {path.name: path for path in files}
        return [load_result(paths[name]) for name in sorted(paths)]
