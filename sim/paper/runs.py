"""Runs of the grid: training one, scoring its parameters, and making many on all cores or a cluster."""

import importlib
import math
from collections.abc import Callable, Sequence
from concurrent.futures import as_completed
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

from rover_ncp.circuit.policy import Policy
from rover_ncp.circuit.policy_file import load_circuit, policy_from_yaml, policy_to_yaml
from rover_ncp.core.errors import UsageError
from sim.learn.cluster import DaskCluster
from sim.learn.engine.networks import Net
from sim.learn.record import made_with
from sim.learn.search.base import Vector, draw_seeds
from sim.learn.workers import ProcessPool, available_processes
from sim.paper import FAITHFUL, BudgetName
from sim.paper.agents import GRADIENTS, NETWORKS, build_agent
from sim.paper.evaluator import Evaluator
from sim.paper.results import Packed, Result, ResultStore, RunName, Score
from sim.paper.search.estimate import BenchmarkEstimator, Budget, Found, ParkingEvaluator
from sim.paper.search.loop import Checkpoint, search_from_one, search_parking
from sim.paper.search.published import SEARCHES
from sim.paper.tasks import Benchmark, Task, find_task

_FINAL = 99
"""Stream of the fresh episodes that a run is judged by."""
_FINAL_EPISODES, _QUICK_EPISODES = 100, 20
_NETWORK_SETTINGS = (10, 5, "published-network", 20_000)
"""Rollouts, worst rollouts and iterations of the published search of MLP and LSTM."""
_QUICK_STEPS = 400_000
"""Steps of a quick run: a few seconds."""
TOLERANCE = 1e-9
"""Difference in a return that another machine may make. A half-cheetah's contacts amplify a last bit, so its
replay is compared by its verdict."""


def budget_for(task: Task, name: BudgetName, agent: str = "circuit") -> Budget:
    """Return a budget: the paper's, one of some core-minutes at most, or one of seconds."""
    (iterations, rollouts, worst), default = task.settings, task.default
    if name is BudgetName.PUBLISHED and agent in NETWORKS:
        return Budget(*_NETWORK_SETTINGS)
    if name in FAITHFUL:
        strategy = task.published_search if name is BudgetName.PUBLISHED else "algorithm1"
        return Budget(rollouts, worst, strategy, iterations, warm_up=task.warm_up)
    strategy = task.published_search if isinstance(task, Benchmark) else "gauss-newton"
    if name is BudgetName.QUICK:
        starts = min(default.untuned, 300 if task.horizon < 1000 else 100)
        limits = {"steps": _QUICK_STEPS, "starts": starts}
        return Budget(min(rollouts, 3), min(worst, 3), strategy, **limits, prunes=True)
    return Budget(rollouts, worst, strategy, steps=default.steps, starts=default.untuned, prunes=True)


def train_run(
    name: RunName, circuit: Path | None = None, state: Path | None = None, every_s: float = 300.0
) -> Result:
    """Make one run. The same name gives the same parameters and returns, to the last bit.

    ``state`` is the file in which the paper's own searches save their state, to continue from there.
    Raises UsageError, FileError or ConfigError for a run that is not possible.
    """
    task = find_task(name.task)
    budget = budget_for(task, name.budget, name.agent)
    checkpoint = Checkpoint(state if name.budget in FAITHFUL else None, vars(budget), every_s)
    agent: Policy | Net | None = None
    libraries: list[str] = []
    if name.agent in GRADIENTS:
        found, steps, settings = _train_by_gradients(task, name)
        libraries = ["stable-baselines3", "torch"]
    else:
        agent = (
            _own_agent(task, circuit) if circuit else build_agent(task, name.agent, name.seed, name.budget)
        )
        found, steps = _search(task, agent, name.seed, budget, checkpoint)
        settings = vars(budget)
    if isinstance(task, Benchmark):
        libraries += ["gymnasium", "mujoco"] if task.model else ["gymnasium"]
    episodes = _QUICK_EPISODES if name.budget is BudgetName.QUICK else _FINAL_EPISODES
    wall_s, cpu_s = checkpoint.times()
    return Result(
        name=name,
        settings=settings,
        made_with=made_with() | {library: metadata.version(library) for library in libraries},
        wall_s=wall_s,
        cpu_s=cpu_s,
        evaluations=found.evaluations,
        steps=steps,
        ended=found.ended,
        curve=found.curve,
        policy=policy_to_yaml(agent) if circuit and isinstance(agent, Policy) else None,
        parameters=Packed.of(found.vector),
        **score(
            task, agent, found.vector, name.seed, episodes=episodes, warm_up=settings.get("warm_up", 0)
        ).model_dump(),
    )


def _own_agent(task: Task, circuit: Path) -> Policy:
    return task.policy(load_circuit(circuit))


def _agent(task: Task, name: RunName) -> Policy | Net:
    return build_agent(task, name.agent, name.seed, name.budget)


def _search(
    task: Task, agent: Policy | Net, seed: int, budget: Budget, checkpoint: Checkpoint
) -> tuple[Found, int]:
    """Return what the search found, and the steps it took."""
    if isinstance(task, Benchmark):
        benchmark = BenchmarkEstimator(task, agent, seed, budget)
        return search_from_one(benchmark, agent, seed, budget, checkpoint), benchmark.steps
    parking = ParkingEvaluator(task, agent)
    if budget.strategy in SEARCHES:
        return search_from_one(parking, agent, seed, budget, checkpoint), parking.steps
    return search_parking(parking, agent, seed, budget), parking.steps


def _train_by_gradients(task: Task, name: RunName) -> tuple[Found, int, dict[str, Any]]:
    from sim.paper.search.gradients import train_actor  # needs the extra gradients

    if name.budget in FAITHFUL:
        raise UsageError(f"the paper states no budget for {name.agent}")
    if not isinstance(task, Benchmark):
        raise UsageError(f"{name.agent} is not trained on {task.name}")
    actor, steps, settings = train_actor(task, name.agent, name.seed, quick=name.budget is BudgetName.QUICK)
    return Found(actor.vector(), 0, (), "steps"), steps, settings


def score(
    task: Task, agent: Policy | Net | None, vector: Vector, seed: int, *, episodes: int, warm_up: int = 0
) -> Score:
    """Return the score of parameters (P,) in fresh episodes.

    Without an agent, the parameters are those of an actor (``search/gradients.py``). Parking is
    deterministic: one episode is enough.
    """
    if not isinstance(task, Benchmark):
        assert agent is not None
        total, parked = ParkingEvaluator(task, agent).outcome(vector)
        success = parked and total >= task.success
        return Score(episodes=1, mean=total, std=0.0, plain_mean=total, success=success)
    seeds = draw_seeds(seed, (_FINAL,), episodes)
    if agent is None:
        from sim.paper.search.gradients import score_actor

        returns, plain = score_actor(task, vector, seeds)
    else:
        evaluator = Evaluator(task, agent, warm_up=warm_up)
        found = evaluator.run(np.tile(vector, (episodes, 1)), seeds)
        returns, plain = found[:, :2].sum(axis=1), found[:, 0]
    plain_mean = float(plain.mean())
    return Score(
        episodes=episodes,
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
    if result.policy is not None:
        agent = policy_from_yaml(result.policy, str(name))
    elif name.agent not in GRADIENTS:
        agent = _agent(task, name)
    vector, warm_up = result.parameters.array(), int(result.settings.get("warm_up", 0))
    return score(task, agent, vector, name.seed, episodes=result.episodes, warm_up=warm_up)


def is_stored(store: ResultStore, name: RunName, circuit: Path | None) -> bool:
    """Whether a run exists; where a circuit file is given, a run of what it contains now."""
    stored = store.find(name)
    if stored is None or circuit is None:
        return stored is not None
    return stored.policy == policy_to_yaml(_own_agent(find_task(name.task), circuit))


def agrees(result: Result, replayed: Score) -> bool:
    """Whether a replay has the stored verdict, and returns within ``TOLERANCE`` except a half-cheetah's."""
    if (replayed.success, replayed.episodes) != (result.success, result.episodes):
        return False
    pairs = zip(replayed, result.score, strict=True)
    return result.name.task == "half-cheetah" or all(
        math.isclose(now, stored, rel_tol=TOLERANCE, abs_tol=TOLERANCE) for (_, now), (_, stored) in pairs
    )


def make_runs(
    names: Sequence[RunName],
    store: ResultStore,
    circuit: Path | None,
    *,
    processes: int | None = None,
    cluster: str | None = None,
    every_s: float = 300.0,
    on_result: Callable[[Result], None],
) -> None:
    """Make runs, as many at once as there are processes, or on a Dask cluster; save each as it ends.

    After an interruption, runs of the paper's own searches continue from their last checkpoint when they are
    requested again. Raises UsageError, FileError or ConfigError before the first run begins, and WorkerDied.
    """
    _require(names, circuit)
    count = min(processes or available_processes(), len(names))
    workers = (
        ProcessPool(count, "; repeat the command to continue") if cluster is None else DaskCluster(cluster)
    )
    with workers:
        runs = [
            workers.submit(train_run, name, circuit, None if cluster else store.checkpoint(name), every_s)
            for name in names
        ]
        for run in as_completed(runs):
            result = run.result()
            store.save(result)
            store.checkpoint(result.name).unlink(missing_ok=True)
            on_result(result)


def _require(names: Sequence[RunName], circuit: Path | None) -> None:
    """Raise the errors of runs before they begin in processes of their own."""
    for task_name, agent in dict.fromkeys((name.task, name.agent) for name in names):
        task = find_task(task_name)
        if circuit is not None:
            _own_agent(task, circuit)
        elif agent in GRADIENTS:
            importlib.import_module("stable_baselines3")
        else:
            build_agent(task, agent, 0)
        if isinstance(task, Benchmark) and task.model:
            importlib.import_module("mujoco")
