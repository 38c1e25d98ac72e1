"""The grid of runs, and the runs that a command line selects."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from rover_ncp.core.errors import UsageError
from sim.paper import BudgetName
from sim.paper.agents import AGENTS, GRADIENTS, LIQUID, PAPERS
from sim.paper.results import RunName
from sim.paper.tasks import TASKS, Benchmark, find_task

_GRADIENT_TASKS = ("pendulum", "roboschool", "mountain-car")
"""The tasks of the paper's table of reinforcement learning."""
_LIQUID_TASKS = ("mountain-car", "parking")
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
            for seed in seeds or range(self.runs)
        ]


def grid(*budgets: BudgetName) -> Iterator[Group]:
    """Yield all groups of some budgets."""
    for budget in budgets:
        for name, task in TASKS.items():
            seeds = _SEEDS
            if budget is BudgetName.ALGORITHM1:
                agents: Sequence[str] = ("circuit",) if name in _ALGORITHM1_TASKS else ()
            elif budget is BudgetName.PUBLISHED:
                agents = PAPERS if isinstance(task, Benchmark) else ("circuit",)
                seeds = _PARKING_SEEDS if name == "parking" else _SEEDS
            else:
                liquid = LIQUID if name in _LIQUID_TASKS else ()
                agents = (*PAPERS, *liquid, *(GRADIENTS if name in _GRADIENT_TASKS else ()))
            yield from (Group(name, agent, budget, seeds) for agent in agents)


def select(
    tasks: Sequence[str] | None,
    agents: Sequence[str] | None,
    seeds: Sequence[int] | None,
    circuit: Path | None,
    budget: BudgetName = BudgetName.DEFAULT,
) -> list[RunName]:
    """Return the selected runs of a budget, circuits first: of the grid, or of any seeds given.

    Without ``agents``, those that need torch are left out. Raises UsageError for an unknown task or agent,
    and where nothing is left.
    """
    for task in tasks or ():
        find_task(task)
    if circuit is not None:
        if agents or not tasks:
            raise UsageError("--circuit FILE is an agent of its own: give --task and no --agent")
        if circuit.stem in AGENTS:
            raise UsageError(f"--circuit {circuit}: {circuit.stem} is an agent of the paper; rename the file")
        return [name for task in tasks for name in Group(task, circuit.stem, budget).names(seeds)]
    for agent in agents or ():
        if agent not in AGENTS:
            raise UsageError(f"no agent {agent!r}; expected one of {', '.join(AGENTS)}")
    wanted = agents or [agent for agent in AGENTS if agent not in GRADIENTS]
    groups = [group for group in grid(budget) if group.agent in wanted and (not tasks or group.task in tasks)]
    groups.sort(key=lambda group: AGENTS.index(group.agent))
    if not groups:
        raise UsageError("the grid has no such runs; rover-ncp paper report --long lists it")
    return [name for group in groups for name in group.names(seeds)]
