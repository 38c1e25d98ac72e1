"""The grid of runs: which there are, which are made, and making the others on all cores.

A run is one file, written when it is over: whatever ends the work, at most the runs in hand are lost.
"""

import multiprocessing
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from dataclasses import dataclass
from pathlib import Path

from sim.paper.agents import GRADIENTS
from sim.paper.cell import Cell, Name, Shelf
from sim.paper.tasks import TASKS
from sim.paper.train import BudgetName, train_cell

__all__ = ["GRID", "Group", "make_runs", "status"]

_GRADIENT_TASKS = ("pendulum", "roboschool", "mountain-car")
"""Those that the paper's table of reinforcement learning has."""


@dataclass(frozen=True)
class Group:
    """The runs of a task and an agent."""

    task: str
    agent: str
    runs: int

    def names(self) -> list[Name]:
        """Return the runs, one for each seed from 0 on."""
        return [Name(task=self.task, agent=self.agent, seed=seed) for seed in range(self.runs)]


def _grid() -> Iterator[Group]:
    for task in TASKS:
        yield Group(task, "circuit", 12 if task == "four-dof" else 10)
        yield Group(task, "random", 10)
        yield Group(task, "mlp", 5)
        yield Group(task, "lstm", 5)
        if task in _GRADIENT_TASKS:
            yield from (Group(task, agent, 5) for agent in GRADIENTS)


GRID = tuple(_grid())


def status(shelf: Shelf) -> list[tuple[Group, int]]:
    """Return each group of the grid with the number of its runs that are made."""
    return [(group, sum(shelf.find(name) is not None for name in group.names())) for group in GRID]


def make_runs(
    names: Sequence[Name],
    shelf: Shelf,
    budget: BudgetName,
    circuit: Path | None,
    *,
    processes: int,
    on_cell: Callable[[Cell], None],
) -> None:
    """Make runs, as many at once as there are processes; each is saved as it ends.

    Raises what a run raises; those in hand are then finished and saved first.
    """
    if processes == 1:
        for name in names:
            cell = train_cell(name, budget, circuit)
            shelf.save(cell)
            on_cell(cell)
        return
    # Spawned, never forked: numba and MuJoCo do not survive a fork.
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(min(processes, len(names)), context) as pool:
        waiting: set[Future[Cell]] = {pool.submit(train_cell, name, budget, circuit) for name in names}
        try:
            while waiting:
                done, waiting = wait(waiting, return_when=FIRST_COMPLETED)
                for future in done:
                    cell = future.result()
                    shelf.save(cell)
                    on_cell(cell)
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise
