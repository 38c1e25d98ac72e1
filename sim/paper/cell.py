"""One run of the grid as a file: what was asked for, what came out, and the trained parameters.

A file is written once, whole, when its run is over. ``replay`` (``train.py``) runs its parameters again and
must find the same returns, to the last bit.
"""

import json
from pathlib import Path
from typing import Any, Literal

from pydantic import ValidationError

from rover_ncp.core.config import StrictModel
from rover_ncp.core.errors import FileError
from rover_ncp.core.files import read_text, write_atomic
from sim.learn.search.base import Vector
from sim.paper.packed import unpack

SHIPPED = Path(__file__).parent / "results"


class Name(StrictModel):
    """Coordinates of a run in the grid."""

    task: str
    agent: str
    seed: int

    def path(self, folder: Path) -> Path:
        """Return a run's file in a folder."""
        return folder / self.task / f"{self.agent}-{self.seed:02}.json"

    def __str__(self) -> str:
        return f"{self.task} {self.agent} {self.seed}"


class Cell(StrictModel):
    """A run that is over."""

    format: Literal[1] = 1
    name: Name
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
    """(steps, estimate of the incumbent), thinned."""
    episodes: int
    """Fresh ones, that the next four are of."""
    mean: float
    """Return, with bonus where the task has one."""
    std: float
    plain_mean: float
    """Gymnasium's return."""
    success: bool
    circuit: str | None = None
    """The wiring, where a file gave it, as the text of a circuit file."""
    parameters: dict[str, Any]
    """The trained vector, packed."""

    @property
    def vector(self) -> Vector:
        """The trained parameters (P,)."""
        return unpack(self.parameters, (None,))


def load_cell(path: Path) -> Cell:
    """Read a run's file. Raises FileError for one that is damaged."""
    try:
        return Cell.model_validate(json.loads(read_text(path)))
    except (ValueError, ValidationError) as error:
        raise FileError(f"{path}: damaged, or not a run of the paper's grid; delete it to redo it") from error


class Shelf:
    """Runs on disk: one's own folder, and behind it those that are shipped."""

    def __init__(self, own: Path, shipped: Path | None = SHIPPED) -> None:
        self.own, self.shipped = own, shipped

    def find(self, name: Name) -> Path | None:
        """Return where a run is, one's own before the shipped one; None if it was not made yet."""
        for folder in (self.own, self.shipped):
            if folder is not None and name.path(folder).is_file():
                return name.path(folder)
        return None

    def save(self, cell: Cell) -> Path:
        """Write a run into one's own folder. Raises FileError."""
        path = cell.name.path(self.own)
        write_atomic(path, json.dumps(cell.model_dump(), allow_nan=False) + "\n")
        return path

    def cells(self, task: str, agent: str) -> list[Cell]:
        """Return all runs of a task and an agent, by seed. Raises FileError."""
        paths: dict[str, Path] = {}
        for folder in (self.shipped, self.own):
            if folder is not None:
                paths |= {path.name: path for path in (folder / task).glob(f"{agent}-*.json")}
        return [load_cell(paths[name]) for name in sorted(paths)]
