"""The grid of runs, the training of a run, and its replay."""

import math
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import as_completed
from dataclasses import replace
from functools import cache
from importlib import metadata
from importlib.util import find_spec
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from paper.episodes import PlantEvaluator, library
from paper.gradients import score_actor, train_actor
from paper.search import Budget, Found, SavedSearch, mark, run_search
from paper.store import BudgetName, Packed, Result, ResultStore, RunName, Score
from paper.tasks import (
    AGENTS,
    GRADIENTS,
    GRID,
    NETWORKS,
    TASKS,
    Benchmark,
    Net,
    Task,
    Vector,
    build_agent,
    draw_seeds,
)
from rover_ncp.circuit.policy import Policy
from rover_ncp.core.errors import UsageError
from rover_ncp.course.course import load_course
from sim.learn.ensemble import train_block
from sim.learn.evaluator import Evaluator
from sim.learn.rollout import rollout
from sim.learn.search.algorithm1 import ALPHA, SIGMA
from sim.learn.settings import TrainSettings, made_with
from sim.learn.workers import ProcessPool, available_processes

_FINAL = 99
"""Stream of random numbers, beside those of ``search.py``: the fresh episodes that a run is judged by."""
_EPISODES = 100
_NETWORK_SETTINGS = (10, 5, "published-network", 20_000)
"""Rollouts, worst rollouts and iterations of the published search of MLP and LSTM."""
_QUICK_ITERATIONS = 30
_source = cache(made_with)  # a process loads its code once
TOLERANCE = 1e-9
"""Difference in a return that another machine may make. A half-cheetah's contacts amplify a last bit, so its
replay is compared by its verdict."""
PAIRS = tuple(product((1.0, 1.001, 1.01, 1.05), (0.01, 0.05, 0.2)))
"""Alpha and first sigma of Algorithm 1, for which the paper gives no numbers."""


def select(
    tasks: Sequence[str] | None,
    agents: Sequence[str] | None,
    seeds: Sequence[int] | None,
    budget: BudgetName = BudgetName.PUBLISHED,
) -> list[RunName]:
    """Return the grid's runs of a budget, or those of any seeds given, circuits and low seeds first.

    Quick runs are those of the published search. Raises UsageError for an unknown task or agent, and where
    nothing is left.
    """
    for what, given, known in (("task", tasks, tuple(TASKS)), ("agent", agents, AGENTS)):
        for name in set(given or ()) - set(known):
            raise UsageError(f"no {what} {name!r}; expected one of {', '.join(known)}")
    wanted = BudgetName.PUBLISHED if budget is BudgetName.QUICK else budget
    names = [
        RunName(task=task, agent=agent, seed=seed, budget=budget, setting=pair)
        for cell in GRID
        for task, agent, pair in product(cell.tasks, cell.agents, PAIRS if cell.pairs else (None,))
        for seed in dict.fromkeys(seeds or range(cell.seeds))
        if cell.budget == wanted and agent in (agents or AGENTS) and task in (tasks or TASKS)
    ]
    if not names:
        raise UsageError(f"the budget {budget} has no such runs; python -m paper report --long lists them")
    return sorted(names, key=lambda name: (AGENTS.index(name.agent), name.seed))


def budget_for(name: RunName) -> Budget:
    """Return the budget of a search: the paper's, or one of seconds."""
    task = TASKS[name.task]
    if name.agent in NETWORKS:
        budget = Budget(*_NETWORK_SETTINGS)
    else:
        iterations, rollouts, worst = task.settings
        strategy, numbers = task.published_search, {}
        if name.budget is BudgetName.ALGORITHM1:
            strategy = "algorithm1" if isinstance(task, Benchmark) else "algorithm1-parking"
            numbers = dict(zip(("alpha", "sigma"), name.setting or (ALPHA, SIGMA), strict=True))
        budget = Budget(rollouts, worst, strategy, iterations, task.warm_up, numbers)
    return replace(budget, iterations=_QUICK_ITERATIONS) if name.budget is BudgetName.QUICK else budget


def train_default(task: Task, number: int) -> tuple[Found, dict[str, Any]]:
    """Train an agent as ``rover-ncp train`` does; return what it found, and the settings."""
    settings, policy = TrainSettings(iterations=task.settings.iterations), task.policy()
    [agent] = train_block(settings, policy, Evaluator(policy, load_course("parking")), [number])
    points = {mark(done): (done, done * task.horizon, value) for done, value in agent.improvements}
    steps = settings.iterations * task.horizon
    found = Found(np.array(agent.vector), steps, tuple(points.values()))
    return found, settings.model_dump(include={"search", "seed", "iterations"})


def train_run(name: RunName, unfinished: Path | None = None) -> Result:
    """Make one run. The same name gives the same parameters and returns, to the last bit.

    A search saves its progress in the file ``unfinished`` and goes on from there. Raises UsageError, and
    FileError if another version began it.
    """
    task, cpu = TASKS[name.task], time.process_time()
    made = _made_with(task, name.agent)  # before the search: files may change while it lasts
    agent = _untrained(name)
    saved: SavedSearch | None = None
    if agent is None:
        assert isinstance(task, Benchmark)
        found, settings = train_actor(task, name.agent, name.seed)
    elif name.budget is BudgetName.DEFAULT:
        found, settings = train_default(task, name.seed)
    else:
        budget = budget_for(name)
        settings = vars(budget)
        saved = SavedSearch(unfinished, {**settings, **made}, time.process_time) if unfinished else None
        found = run_search(task, agent, name.seed, budget, saved)
    return Result(
        name=name,
        settings=settings,
        made_with=made,
        cpu_s=saved.cpu_s if saved else time.process_time() - cpu,
        steps=found.steps,
        curve=found.curve,
        parameters=Packed.of(found.vector),
        **score(task, agent, found.vector, name.seed, settings.get("warm_up", 0)).model_dump(),
    )


def _made_with(task: Task, agent: str) -> dict[str, str]:
    libraries = ["stable-baselines3", "torch"] if agent in GRADIENTS else []
    if isinstance(task, Benchmark):
        libraries += ["gymnasium", "mujoco"] if task.mujoco else ["gymnasium"]
    return _source() | {library: metadata.version(library) for library in libraries}


def score(task: Task, agent: Policy | Net | None, vector: Vector, seed: int, warm_up: int) -> Score:
    """Return the score of parameters (P,) in fresh episodes.

    Without an agent, the parameters are those of an actor (``gradients.py``). Parking is
    deterministic: one episode is enough.
    """
    parked, seeds = True, draw_seeds(seed, (_FINAL,), _EPISODES)
    if not isinstance(task, Benchmark):
        assert isinstance(agent, Policy)
        drive = rollout(agent.with_parameters(vector), load_course("parking"))
        parked, returns = drive.verdict.parked, np.array([drive.total])
        plain = returns
    elif agent is None:
        returns, plain = score_actor(task, vector, seeds)
    else:
        found = PlantEvaluator(task, agent, warm_up=warm_up).run(np.tile(vector, (_EPISODES, 1)), seeds)
        returns, plain = found[:, :2].sum(axis=1), found[:, 0]
    return Score(
        episodes=len(returns),
        mean=float(returns.mean()),
        std=float(returns.std()),
        plain_mean=float(plain.mean()),
        success=parked and float(plain.mean()) >= task.success,
    )


def replay(result: Result) -> Score:
    """Return the score of a stored run's parameters now."""
    task, agent = TASKS[result.name.task], _untrained(result.name)
    return score(task, agent, result.parameters.array(), result.name.seed, result.settings.get("warm_up", 0))


def _untrained(name: RunName) -> Policy | Net | None:
    return None if name.agent in GRADIENTS else build_agent(TASKS[name.task], name.agent, name.seed)


def agrees(result: Result, replayed: Score) -> bool:
    """Whether a replay has the stored verdict, and returns within ``TOLERANCE`` except a half-cheetah's."""
    pairs = ((now, getattr(result, field)) for field, now in replayed)
    close = all(math.isclose(now, stored, rel_tol=TOLERANCE, abs_tol=TOLERANCE) for now, stored in pairs)
    return replayed.success == result.success and (close or result.name.task == "half-cheetah")


def make_runs(names: Sequence[RunName], store: ResultStore, processes: int | None) -> Iterator[Result]:
    """Make runs, as many at once as there are processes; save each as it ends, and yield it.

    After an interruption a search goes on from where it was saved last. Raises UsageError before the first
    run begins.
    """
    if {name.agent for name in names} & set(GRADIENTS) and not find_spec("stable_baselines3"):
        raise UsageError("ppo and a2c need stable-baselines3: make paper-gradients installs it")
    library()
    with ProcessPool(min(processes or available_processes(), len(names))) as pool:
        for run in as_completed([pool.submit(train_run, name, store.unfinished(name)) for name in names]):
            result: Result = run.result()
            store.save(result)
            store.unfinished(result.name).unlink(missing_ok=True)
            yield result
