"""Runs of the grid: training one, scoring its parameters, and making many on all cores."""

import importlib
import math
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import as_completed
from dataclasses import replace
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from paper.agents import AGENTS, GRADIENTS, NETWORKS, PAPERS, build_agent
from paper.evaluator import Evaluator
from paper.loop import Budget, Checkpoint, ParkingEvaluator, run_search
from paper.networks import Net
from paper.store import BudgetName, Packed, Result, ResultStore, RunName, Score
from paper.tasks import TASKS, Benchmark, Task, find_task
from rover_ncp.circuit.policy import Policy
from rover_ncp.core.errors import RoverNcpError, UsageError
from sim.learn.record import made_with
from sim.learn.search.base import Vector, draw_seeds
from sim.learn.workers import ProcessPool, available_processes

_FINAL = 99
"""Stream of the fresh episodes that a run is judged by."""
_EPISODES = 100
_NETWORK_SETTINGS = (10, 5, "published-network", 20_000)
"""Rollouts, worst rollouts and iterations of the published search of MLP and LSTM."""
_QUICK_ITERATIONS = 30
_source = cache(made_with)  # a process loads its code once
TOLERANCE = 1e-9
"""Difference in a return that another machine may make. A half-cheetah's contacts amplify a last bit, so its
replay is compared by its verdict."""


def budget_for(task: Task, name: BudgetName, agent: str = "circuit") -> Budget:
    """Return the budget of a search: the paper's, or one of seconds."""
    if agent in NETWORKS:
        budget = Budget(*_NETWORK_SETTINGS)
    else:
        iterations, rollouts, worst = task.settings
        strategy = "algorithm1" if name is BudgetName.ALGORITHM1 else task.published_search
        budget = Budget(rollouts, worst, strategy, iterations, task.warm_up)
    return replace(budget, iterations=_QUICK_ITERATIONS) if name is BudgetName.QUICK else budget


def train_run(name: RunName, state: Path | None = None) -> Result:
    """Make one run. The same name gives the same parameters and returns, to the last bit.

    ``state`` is the file in which a search saves its state, to continue from there. Raises UsageError
    for a run that is not possible, and FileError.
    """
    task = find_task(name.task)
    agent: Policy | Net | None = None
    settings: dict[str, Any]
    made = _made_with(task, name.agent)  # before the search: files may change while it lasts
    if name.agent in GRADIENTS:
        from paper.gradients import train_actor  # needs the extra gradients

        assert isinstance(task, Benchmark)
        checkpoint = Checkpoint(None, {})
        found, settings = train_actor(task, name.agent, name.seed)
    else:
        agent = build_agent(task, name.agent, name.seed)
        budget = budget_for(task, name.budget, name.agent)
        settings = vars(budget)
        checkpoint = Checkpoint(state, {**settings, **made})
        found = run_search(task, agent, name.seed, budget, checkpoint)
    wall_s, cpu_s = checkpoint.times()
    return Result(
        name=name,
        settings=settings,
        made_with=made,
        wall_s=wall_s,
        cpu_s=cpu_s,
        evaluations=found.evaluations,
        steps=found.steps,
        curve=found.curve,
        parameters=Packed.of(found.vector),
        **score(task, agent, found.vector, name.seed, settings.get("warm_up", 0)).model_dump(),
    )


def _made_with(task: Task, agent: str) -> dict[str, str]:
    libraries = ["stable-baselines3", "torch"] if agent in GRADIENTS else []
    if isinstance(task, Benchmark):
        libraries += ["gymnasium", "mujoco"] if task.model else ["gymnasium"]
    return _source() | {library: metadata.version(library) for library in libraries}


def score(task: Task, agent: Policy | Net | None, vector: Vector, seed: int, warm_up: int) -> Score:
    """Return the score of parameters (P,) in fresh episodes.

    Without an agent, the parameters are those of an actor (``search/gradients.py``). Parking is
    deterministic: one episode is enough.
    """
    if not isinstance(task, Benchmark):
        assert isinstance(agent, Policy)
        total, parked = ParkingEvaluator(task, agent).outcome(vector)
        success = parked and total >= task.success
        return Score(episodes=1, mean=total, std=0.0, plain_mean=total, success=success)
    seeds = draw_seeds(seed, (_FINAL,), _EPISODES)
    if agent is None:
        from paper.gradients import score_actor

        returns, plain = score_actor(task, vector, seeds)
    else:
        evaluator = Evaluator(task, agent, warm_up=warm_up)
        found = evaluator.run(np.tile(vector, (_EPISODES, 1)), seeds)
        returns, plain = found[:, :2].sum(axis=1), found[:, 0]
    plain_mean = float(plain.mean())
    return Score(
        episodes=_EPISODES,
        mean=float(returns.mean()),
        std=float(returns.std()),
        plain_mean=plain_mean,
        success=plain_mean >= task.success,
    )


def replay(result: Result) -> Score:
    """Return the score of a stored run's parameters now."""
    name = result.name
    agent: Policy | Net | None = None
    task = find_task(name.task)
    if name.agent not in GRADIENTS:
        agent = build_agent(task, name.agent, name.seed)
    return score(task, agent, result.parameters.array(), name.seed, result.settings.get("warm_up", 0))


def agrees(result: Result, replayed: Score) -> bool:
    """Whether a replay has the stored verdict, and returns within ``TOLERANCE`` except a half-cheetah's."""
    pairs = ((now, getattr(result, field)) for field, now in replayed)
    close = all(math.isclose(now, stored, rel_tol=TOLERANCE, abs_tol=TOLERANCE) for now, stored in pairs)
    return replayed.success == result.success and (close or result.name.task == "half-cheetah")


def make_runs(
    names: Sequence[RunName],
    store: ResultStore,
    *,
    processes: int | None = None,
    on_result: Callable[[Result], None],
) -> None:
    """Make runs, as many at once as there are processes; save each as it ends.

    After an interruption, a search continues from its last checkpoint when it is requested again. Raises
    UsageError before the first run begins; after the others, the error of a run; WorkerDied.
    """
    _require(names)
    count = min(processes or available_processes(), len(names))
    with ProcessPool(count, "; repeat the command to continue") as workers:
        runs = [workers.submit(train_run, name, store.checkpoint(name)) for name in names]
        errors: list[RoverNcpError] = []
        for run in as_completed(runs):
            try:
                result = run.result()
            except RoverNcpError as error:  # the others go on
                errors.append(error)
                continue
            store.save(result)
            store.checkpoint(result.name).unlink(missing_ok=True)
            on_result(result)
        if errors:
            raise errors[0]


def _require(names: Sequence[RunName]) -> None:
    """Raise the errors of runs before they begin in processes of their own."""
    for task_name, agent in dict.fromkeys((name.task, name.agent) for name in names):
        task = find_task(task_name)
        if agent in GRADIENTS:
            try:
                importlib.import_module("stable_baselines3")
            except ImportError as error:
                raise UsageError(
                    f"{agent} needs stable-baselines3: make paper-gradients installs it"
                ) from error
        if isinstance(task, Benchmark) and task.model:
            importlib.import_module("mujoco")


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
