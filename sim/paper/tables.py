"""The paper's tables, from the runs that are made.

Beside each cell stands the paper's, and a verdict: better or worse if Welch's t-test, on mean, standard
deviation and number of runs of both, finds a difference at the 5 % level, otherwise equal within noise.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import numpy as np

from sim.paper.agents import AGENTS
from sim.paper.cell import Cell, Shelf
from sim.paper.grid import GRID
from sim.paper.published import RUNS, SPARSITY, Reported, reported
from sim.paper.tasks import TASKS
from sim.paper.train import BudgetName, budget_for

LEVEL = 0.05


class Table(StrEnum):
    """Which agents are compared."""

    RANDOM = "table1"
    GRADIENTS = "table2"
    DEEP = "table3"


TABLES: Mapping[Table, tuple[str, ...]] = {
    Table.RANDOM: ("circuit", "random"),
    Table.GRADIENTS: ("circuit", "ppo", "a2c"),
    Table.DEEP: ("lstm", "mlp", "circuit", "random"),
}


class Verdict(StrEnum):
    """Ours against the paper's."""

    BETTER = "better"
    EQUAL = "equal within noise"
    WORSE = "worse"


@dataclass(frozen=True)
class Entry:
    """A cell of a table: the runs of a task and an agent."""

    task: str
    agent: str
    runs: int
    wanted: int
    mean: float | None
    std: float | None
    """Over runs, of a sample; None for fewer than two."""
    plain_mean: float | None
    success_rate: float | None
    cpu_s: float | None
    """Mean of a run."""
    published: Reported | None
    verdict: Verdict | None
    p: float | None

    def fields(self) -> dict[str, Any]:
        """Return what ``--json`` prints."""
        published = self.published._asdict() | {"runs": RUNS} if self.published else None
        sparsity = SPARSITY.get(self.agent)
        return vars(self) | {"published": published, "sparsity": sparsity, "test": "Welch"}


def verdict(mean: float, std: float, runs: int, published: Reported) -> tuple[Verdict, float]:
    """Return how runs compare with the paper's, and the probability of such a difference by chance."""
    from scipy.stats import ttest_ind_from_stats

    if std == 0.0 and published.std == 0.0:
        p = 1.0 if mean == published.mean else 0.0
    else:
        p = float(
            ttest_ind_from_stats(mean, std, runs, published.mean, published.std, RUNS, equal_var=False).pvalue
        )
    if p >= LEVEL:
        return Verdict.EQUAL, p
    return (Verdict.BETTER if mean > published.mean else Verdict.WORSE), p


def entry(task: str, agent: str, wanted: int, cells: Sequence[Cell]) -> Entry:
    """Return the cell of a table."""
    paper, judged, p = reported(task, agent), None, None
    mean = std = plain = success = cpu_s = None
    if cells:
        means = np.array([cell.mean for cell in cells])
        mean, plain = float(means.mean()), float(np.mean([cell.plain_mean for cell in cells]))
        success = float(np.mean([cell.success for cell in cells]))
        cpu_s = float(np.mean([cell.cpu_s for cell in cells]))
    if len(cells) > 1:
        std = float(means.std(ddof=1))
        if paper is not None and mean is not None:
            judged, p = verdict(mean, std, len(cells), paper)
    return Entry(task, agent, len(cells), wanted, mean, std, plain, success, cpu_s, paper, judged, p)


def table(which: Table, shelf: Shelf) -> list[Entry]:
    """Return a table's cells, by task, those without a run as well. Raises FileError."""
    agents = TABLES[which]
    return [
        entry(group.task, group.agent, group.runs, shelf.cells(group.task, group.agent))
        for task in TASKS
        for agent in agents
        for group in GRID
        if (group.task, group.agent) == (task, agent)
        and (which is not Table.GRADIENTS or _has_gradients(task))
    ]


def _has_gradients(task: str) -> bool:
    return any(group.task == task and group.agent == AGENTS[-1] for group in GRID)


def parameters() -> list[dict[str, Any]]:
    """Return the experiments' parameters: the paper's, and what a run may take by default."""
    rows = []
    for task in TASKS.values():
        policy = task.policy(task.circuit())
        ours = budget_for(task, BudgetName.DEFAULT)
        rows.append(
            {
                "task": task.name,
                "horizon": task.horizon,
                "iterations": task.settings.iterations,
                "rollouts": task.settings.rollouts,
                "worst": task.settings.worst,
                "success": task.success,
                "default_steps": ours.steps,
                "default_starts": ours.starts,
                "neurons": policy.circuit.size,
                "synapses": policy.circuit.synapse_count,
                "parameters": policy.layout().size,
                "sensors": {channel.name: dict(channel.sides) for channel in policy.sensing.channels},
                "motors": {channel.name: dict(channel.sides) for channel in policy.motors.channels},
            }
        )
    return rows
