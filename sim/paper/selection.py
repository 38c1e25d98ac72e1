"""The grid of runs, and the runs that a command line selects."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

from rover_ncp.core.errors import UsageError
from sim.paper import BudgetName
from sim.paper.agents import AGENTS, GRADIENTS, PAPERS
from sim.paper.results import RunName
from sim.paper.tasks import TASKS, Benchmark, Task, find_task

_GRADIENT_TASKS = ("pendulum", "mountain-car")
"""The tasks of the paper's table of reinforcement learning."""
_ALGORITHM1_TASKS = ("parking", "pendulum", "mountain-car", "cart-pole")
_SEEDS = 10
_PARKING_SEEDS = 48
"""As many as were measured with the published code itself."""


class Group(NamedTuple):
    """The runs of a task, an agent and a budget, one for each seed from 0 on."""

    task: str
    agent: str
    budget: BudgetName
    runs: int = _SEEDS

    def names(self, seeds: Sequence[int] | None = None) -> list[RunName]:
        """Return the group's runs, or those of the seeds given."""
        return [
            RunName(task=self.task, agent=self.agent, seed=seed, budget=self.budget)
            for seed in dict.fromkeys(seeds or range(self.runs))
        ]


def grid(*budgets: BudgetName) -> Iterator[Group]:
    """Yield all groups of some budgets."""
    for budget in budgets:
        for name, task in TASKS.items():
            seeds = _PARKING_SEEDS if (name, budget) == ("parking", BudgetName.PUBLISHED) else _SEEDS
            yield from (Group(name, agent, budget, seeds) for agent in _agents(task, budget))


def _agents(task: Task, budget: BudgetName) -> Sequence[str]:
    if budget is BudgetName.GRADIENTS:
        return GRADIENTS if task.name in _GRADIENT_TASKS else ()
    if budget is BudgetName.ALGORITHM1:
        return ("circuit",) if task.name in _ALGORITHM1_TASKS else ()
    return PAPERS if isinstance(task, Benchmark) else ("circuit",)


def select(
    tasks: Sequence[str] | None,
    agents: Sequence[str] | None,
    seeds: Sequence[int] | None,
    budget: BudgetName = BudgetName.PUBLISHED,
) -> list[RunName]:
    """Return the selected runs of a budget, circuits first: of the grid, or of any seeds given.

    Raises UsageError for an unknown task or agent, and where nothing is left.
    """
    for task in tasks or ():
        find_task(task)
    for agent in agents or ():
        if agent not in AGENTS:
            raise UsageError(f"no agent {agent!r}; expected one of {', '.join(AGENTS)}")
    groups = [
        group
        for group in grid(budget)
        if (not agents or group.agent in agents) and (not tasks or group.task in tasks)
    ]
    groups.sort(key=lambda group: AGENTS.index(group.agent))
    if not groups:
        raise UsageError(
            f"the budget {budget} has no such runs; rover-ncp paper report --long lists those of each budget"
        )
    return [name for group in groups for name in group.names(seeds)]
