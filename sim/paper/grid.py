"""The grid of runs: which there are, which are made, and making the others on all cores.

A run is one file, written when it is over: whatever ends the work, at most the runs in hand are lost.
"""

import importlib
import multiprocessing
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from pathlib import Path

from sim.learn.workers import WorkerDied, starting_processes
from sim.paper.agents import GRADIENTS, build_agent
from sim.paper.cell import Cell, Name, Shelf
from sim.paper.tasks import TASKS, Benchmark, find_task
from sim.paper.train import BudgetName, train_cell

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
    cluster: str | None = None,
    on_cell: Callable[[Cell], None],
) -> None:
    """Make runs, as many at once as there are processes, or on a cluster; each is saved as it ends.

    Interrupted, it gives up the runs in hand. Raises UsageError, FileError or ConfigError before the first
    run for one that cannot be, and WorkerDied.
    """
    _require(names, circuit)

    def keep(cell: Cell) -> None:
        shelf.save(cell)
        on_cell(cell)

    if cluster is not None:
        from sim.paper.cluster import make_on_cluster  # an extra that one machine does without

        make_on_cluster(names, budget, cluster, keep)
        return
    if processes == 1:
        for name in names:
            keep(train_cell(name, budget, circuit))
        return
    # Spawned, never forked: numba and MuJoCo do not survive a fork.
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(min(processes, len(names)), context) as pool:
        try:
            with starting_processes():  # the pool starts them as work is handed in
                runs: list[Future[Cell]] = [pool.submit(train_cell, name, budget, circuit) for name in names]
            for run in as_completed(runs):
                keep(run.result())
        except BaseException as error:
            pool.shutdown(wait=False, cancel_futures=True)
            for child in multiprocessing.active_children():
                child.kill()
            if isinstance(error, BrokenProcessPool):
                raise WorkerDied("the process of a run was ended; say the same again to go on") from error
            raise


def _require(names: Sequence[Name], circuit: Path | None) -> None:
    """Raise what runs would raise in processes of their own, where errors do not all survive the way back."""
    for task_name, agent in dict.fromkeys((name.task, name.agent) for name in names):
        task = find_task(task_name)
        if circuit is not None or agent not in GRADIENTS:
            build_agent(task, agent, 0, circuit)
        else:
            importlib.import_module("stable_baselines3")
        if isinstance(task, Benchmark) and task.mujoco:
            importlib.import_module("mujoco")
