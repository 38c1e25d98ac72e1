"""Runs of the grid: training one, scoring its parameters, and making many on all cores or a cluster."""

import importlib
import math
from collections.abc import Callable, Sequence
from concurrent.futures import as_completed
from dataclasses import replace
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

from rover_ncp.circuit.policy import Policy
from rover_ncp.core.errors import RoverNcpError
from sim.learn.cluster import DaskCluster
from sim.learn.engine.networks import Net
from sim.learn.record import made_with
from sim.learn.search.base import Vector, draw_seeds
from sim.learn.workers import ProcessPool, available_processes
from sim.paper import BudgetName
from sim.paper.agents import GRADIENTS, NETWORKS, build_agent
from sim.paper.evaluator import Evaluator
from sim.paper.results import Packed, Result, ResultStore, RunName, Score
from sim.paper.search.loop import Budget, Checkpoint, ParkingEvaluator, run_search
from sim.paper.tasks import Benchmark, Task, find_task

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
        from sim.paper.search.gradients import train_actor  # needs the extra gradients

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
        from sim.paper.search.gradients import score_actor

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
    cluster: str | None = None,
    on_result: Callable[[Result], None],
) -> None:
    """Make runs, as many at once as there are processes, or on a Dask cluster; save each as it ends.

    After an interruption, a search continues from its last checkpoint when it is requested again, except on a
    cluster. Raises UsageError before the first run begins; after the others, the error of a run; WorkerDied.
    """
    _require(names)
    count = min(processes or available_processes(), len(names))
    workers = (
        ProcessPool(count, "; repeat the command to continue") if cluster is None else DaskCluster(cluster)
    )
    with workers:
        runs = [
            workers.submit(train_run, name, None if cluster else store.checkpoint(name)) for name in names
        ]
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
            importlib.import_module("stable_baselines3")
        if isinstance(task, Benchmark) and task.model:
            importlib.import_module("mujoco")
