"""The grid of runs behind the paper's tables, and the runs that a command line selects."""

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from rover_ncp.core.errors import UsageError
from sim.paper import FAITHFUL, BudgetName
from sim.paper.agents import AGENTS, GRADIENTS, LIQUID, PAPERS
from sim.paper.search.published import read_partial
from sim.paper.results import Result, ResultStore, RunName, load_result
from sim.paper.tasks import TASKS, Benchmark, find_task

_GRADIENT_TASKS = ("pendulum", "roboschool", "mountain-car")
"""The tasks of the paper's table of reinforcement learning."""
LIQUID_TASKS = ("mountain-car", "parking")
"""The tasks on which what has come since is compared."""
_OWN_RUNS = 5
"""Runs of a circuit of the user's own."""


class Group(NamedTuple):
    """The runs of a task, an agent and a budget, one for each seed from 0 on."""

    task: str
    agent: str
    runs: int
    budget: BudgetName = BudgetName.DEFAULT

    def names(self, seeds: Sequence[int] | None = None) -> list[RunName]:
        """Return the group's runs, or those of the seeds given."""
        return [
            RunName(task=self.task, agent=self.agent, seed=seed, budget=self.budget)
            for seed in seeds or range(self.runs)
        ]

    def results(self, store: ResultStore) -> list[Result]:
        """Return the group's runs that exist, by seed. Raises FileError."""
        return store.results(self.task, self.agent, self.budget)


def grid(budget: BudgetName = BudgetName.DEFAULT) -> tuple[Group, ...]:
    """Return all groups of a budget."""
    return tuple(_faithful(budget) if budget in FAITHFUL else _own(budget))


def _own(budget: BudgetName) -> Iterator[Group]:
    for task in TASKS:
        yield Group(task, "circuit", 12 if task == "four-dof" else 10, budget)
        yield Group(task, "random", 10 if task == "half-cheetah" else 20, budget)
        yield Group(task, "mlp", 5, budget)
        yield Group(task, "lstm", 5, budget)
        if task in _GRADIENT_TASKS:
            yield from (Group(task, agent, 5, budget) for agent in GRADIENTS)
        if task in LIQUID_TASKS:
            yield from (Group(task, agent, 5, budget) for agent in LIQUID)


def _faithful(budget: BudgetName) -> Iterator[Group]:
    """Yield the paper's ten runs of each row; only circuits park."""
    for name, task in TASKS.items():
        both_estimates_agree = task.settings.worst == task.settings.rollouts
        if budget is BudgetName.PUBLISHED_MEAN and both_estimates_agree:
            continue
        if not isinstance(task, Benchmark):
            yield Group(name, "circuit", 36 if name == "parking" else 12, budget)
            continue
        yield from (Group(name, agent, 10, budget) for agent in PAPERS)


def coverage(store: ResultStore, budget: BudgetName = BudgetName.DEFAULT) -> list[dict[str, Any]]:
    """Return each group of a budget: how many of its runs came to an end, how, and the commits of them.

    A run that has not ended is listed with its iterations and the estimate of its incumbent.
    """
    rows = []
    for group in grid(budget):
        paths = [store.find(name) for name in group.names()]
        results = [load_result(path) for path in paths if path is not None]
        commits = Counter(result.made_with.get("commit", "unknown") for result in results)
        rows.append(
            {
                "task": group.task,
                "agent": group.agent,
                "made": len(results),  #: how many runs came to an end
                "runs": group.runs,  #: how many are wanted
                "commits": dict(commits),  #: by commit: how many runs
                #: by how a run ended: how many runs
                "ended": dict(Counter(result.ended for result in results)),
                "cpu_s": sum(result.cpu_s for result in results),  #: of all together
                "unfinished": [  #: runs of the paper's own searches that have not ended
                    {"seed": name.seed, **read_partial(store.unfinished(name))}
                    for name in group.names()
                    if store.unfinished(name).is_file() and store.find(name) is None
                ],
            }
        )
    return rows


def select(
    tasks: Sequence[str] | None,
    agents: Sequence[str] | None,
    seeds: Sequence[int] | None,
    circuit: Path | None,
    budgets: Iterable[BudgetName] = (BudgetName.DEFAULT,),
) -> list[RunName]:
    """Return the selected runs of budgets, circuits first: of the grid, or of any seeds given.

    Without ``agents``, those that need torch are left out. Raises UsageError for an unknown task or agent,
    and where nothing is left.
    """
    for task in tasks or ():
        find_task(task)
    if circuit is not None:
        if agents or not tasks:
            raise UsageError("--circuit FILE is an agent by itself; it wants a --task")
        groups = [Group(task, circuit.stem, _OWN_RUNS, budget) for budget in budgets for task in tasks]
        return [name for group in groups for name in group.names(seeds)]
    for agent in agents or ():
        if agent not in AGENTS:
            raise UsageError(f"no agent {agent!r}; there are {', '.join(AGENTS)}")
    wanted = agents or [agent for agent in AGENTS if agent not in GRADIENTS]
    groups = [group for budget in budgets for group in grid(budget)]
    names = [
        name
        for agent in AGENTS
        for group in groups
        if group.agent == agent and agent in wanted and (not tasks or group.task in tasks)
        for name in group.names(seeds)
    ]
    if not names:
        raise UsageError("the grid has no such runs; rover-ncp paper status lists it")
    return names
