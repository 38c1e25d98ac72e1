"""Runs of the grid on the workers of a Dask cluster: each a task of its own, and the same bits anywhere."""

import threading
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from sim.learn.cluster import RETRIES, connect, require_versions, told_plainly, versions
from sim.paper.cell import Cell, Name
from sim.paper.train import BudgetName, train_cell

# A worker may have several threads; a run's time is that of its process.
_one_run = threading.Lock()


def make_on_cluster(
    names: Sequence[Name], budget: BudgetName, address: str, on_cell: Callable[[Cell], None]
) -> None:
    """Make runs, and hand each over as it ends. Those of a worker that dies are made by another one.

    Raises UsageError where there is no cluster or none that can make the same runs, and ClusterLost.
    """
    from distributed import as_completed

    completed: Any = as_completed
    client = connect(address)
    try:
        with told_plainly(address):
            wanted = versions()
            runs = [
                client.submit(_run, name, budget, wanted, pure=False, retries=RETRIES, priority=-number)
                for number, name in enumerate(names)
            ]
            for run in completed(runs, loop=client.loop):
                on_cell(run.result())
    finally:
        client.close()


def _run(name: Name, budget: BudgetName, wanted: Mapping[str, str]) -> Cell:
    """Make a run, on a worker."""
    require_versions(wanted)
    with _one_run:
        return train_cell(name, budget)
