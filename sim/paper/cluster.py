"""Runs of the grid on the workers of a Dask cluster: each a task of its own, and the same bits anywhere."""

from collections.abc import Callable, Sequence
from concurrent.futures import as_completed

from sim.learn.cluster import DaskCluster
from sim.paper.cell import Cell, Name
from sim.paper.train import BudgetName, train_cell


def make_on_cluster(
    names: Sequence[Name], budget: BudgetName, address: str, on_cell: Callable[[Cell], None]
) -> None:
    """Make runs, and hand each over as it ends. Those of a worker that dies are made by another one.

    Raises UsageError where there is no cluster or none that can make the same runs, and ClusterLost.
    """
    with DaskCluster(address) as cluster:
        for run in as_completed([cluster.submit(train_cell, name, budget) for name in names]):
            on_cell(run.result())
