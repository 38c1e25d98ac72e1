"""One run of the grid, from its name to its file's content."""

import shlex
import time
from collections.abc import Callable
from dataclasses import replace
from enum import StrEnum
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

from rover_ncp.circuit.policy import Policy
from rover_ncp.circuit.policy_file import circuit_to_yaml
from rover_ncp.core.errors import UsageError
from sim.learn.networks import Net
from sim.learn.record import made_with
from sim.learn.search.base import Vector
from sim.paper.agents import GRADIENTS, build_agent
from sim.paper.arena import Arena, draw_seeds
from sim.paper.cell import Cell, Name
from sim.paper.cma_search import CMA, search_by_cma
from sim.paper.evolution import EVOLUTION, search_by_evolution
from sim.paper.packed import pack
from sim.paper.parking import ParkingArena, search_parking
from sim.paper.search import Budget, Found, search_benchmark
from sim.paper.tasks import Benchmark, SearchName, Task, find_task

_FINAL = 99
_CURVE_POINTS = 60
_UNLIMITED = 10**12
_QUICK_STEPS = 400_000
"""Steps of a quick run: a few seconds."""


class BudgetName(StrEnum):
    """Budget of a run."""

    QUICK = "quick"
    DEFAULT = "default"
    PUBLISHED = "published"


_EPISODES = {BudgetName.QUICK: 20}
_MOST_EPISODES = 100
"""Fresh ones by which a run is judged."""


def budget_for(task: Task, name: BudgetName) -> Budget:
    """Return a budget: the paper's, one of some core-minutes at most, or one of seconds."""
    settings = task.settings
    starts = task.starts if isinstance(task, Benchmark) else 1
    full = Budget(settings.rollouts, settings.worst, _UNLIMITED, task.steps, starts, patience=15_000)
    if name is BudgetName.PUBLISHED:
        return replace(
            full,
            evaluations=settings.iterations,
            steps=_UNLIMITED,
            patience=_UNLIMITED,
            starts=1,
            published=True,
        )
    if name is BudgetName.QUICK:
        return replace(
            full,
            rollouts=min(full.rollouts, 3),
            worst=min(full.worst, 3),
            steps=_QUICK_STEPS,
            starts=min(starts, 300 if task.horizon < 1000 else 100),
        )
    return full


def train_cell(
    name: Name,
    budget: BudgetName = BudgetName.DEFAULT,
    circuit: Path | None = None,
    on_progress: Callable[[int, float], None] = lambda steps, value: None,
) -> Cell:
    """Make one run. The same name and budget give the same parameters and returns, to the last bit.

    Raises UsageError, FileError or ConfigError for a run that cannot be.
    """
    began, worked = time.monotonic(), time.process_time()
    task, limits = find_task(name.task), budget_for(find_task(name.task), budget)
    if name.agent in GRADIENTS and circuit is None:
        return _train_by_gradients(name, task, budget, (began, worked))
    agent = build_agent(task, name.agent, name.seed, circuit)
    arena = _arena(task, agent)
    if isinstance(arena, Arena):
        trials = arena if arena.task.stand_in is None else Arena(arena.task, agent, rough=True)
        how = _search_name(arena.task, limits)
        if how is SearchName.EVOLUTION:
            found = search_by_evolution(trials, agent, name.seed, limits, on_progress)
        else:
            search = search_by_cma if how is SearchName.CMA else search_benchmark
            found = search(trials, arena, agent, name.seed, limits, on_progress=on_progress)
        steps = arena.steps + (0 if trials is arena else trials.steps)
    else:
        found = search_parking(arena, agent, name.seed, limits, on_progress)
        steps = arena.steps
    return Cell(
        name=name,
        command=_command(name, budget, circuit),
        budget=budget,
        settings=_settings(task, limits),
        made_with=made_with() | _versions(task),
        wall_s=time.monotonic() - began,
        cpu_s=time.process_time() - worked,
        evaluations=found.evaluations,
        steps=steps,
        ended=found.ended,
        curve=_thinned(found),
        circuit=circuit_to_yaml(agent.circuit) if circuit and isinstance(agent, Policy) else None,
        parameters=pack(found.vector),
        **score(task, agent, found.vector, name.seed, _EPISODES.get(budget, _MOST_EPISODES)),
    )


def _settings(task: Task, limits: Budget) -> dict[str, Any]:
    search: dict[str, Any] | None = {SearchName.CMA: CMA, SearchName.EVOLUTION: EVOLUTION}.get(
        _search_name(task, limits)
    )
    return vars(limits) if search is None else {"steps": limits.steps, "starts": limits.starts, **search}


def _search_name(task: Task, limits: Budget) -> SearchName:
    return task.search if isinstance(task, Benchmark) and not limits.published else SearchName.PUBLISHED


def _train_by_gradients(name: Name, task: Task, budget: BudgetName, began: tuple[float, float]) -> Cell:
    # An extra that the other agents do without.
    from sim.paper.gradients import CELLS, train_actor, training_of

    if budget is BudgetName.PUBLISHED:
        raise UsageError(f"the paper states no budget for {name.agent}")
    actor, steps = train_actor(task, name.agent, name.seed, quick=budget is BudgetName.QUICK)
    assert isinstance(task, Benchmark)
    training = training_of(task, name.agent)
    return Cell(
        name=name,
        command=_command(name, budget, None),
        budget=budget,
        settings={"cells": CELLS, "environments": training.environments, **training.options},
        made_with=made_with() | _versions(task, "stable-baselines3", "torch"),
        wall_s=time.monotonic() - began[0],
        cpu_s=time.process_time() - began[1],
        evaluations=0,
        steps=steps,
        ended="steps",
        curve=(),
        parameters=pack(actor.vector()),
        **score(task, None, actor.vector(), name.seed, _EPISODES.get(budget, _MOST_EPISODES)),
    )


def score(task: Task, agent: Policy | Net | None, vector: Vector, seed: int, episodes: int) -> dict[str, Any]:
    """Return how parameters (P,) do in fresh episodes: the fields ``episodes`` to ``success`` of a run.

    Without an agent they are those of an actor (``gradients.py``). Parking has no chance: one is all.
    """
    seeds = draw_seeds(seed, (_FINAL,), episodes)
    if agent is None:
        from sim.paper.gradients import score_actor

        return _summary(task, *score_actor(task, vector, seeds))
    arena = _arena(task, agent)
    if isinstance(arena, ParkingArena):
        outcome = arena.outcome(vector)
        return {
            "episodes": 1,
            "mean": outcome.total,
            "std": 0.0,
            "plain_mean": outcome.total,
            "success": outcome.parked and outcome.total >= task.success,
        }
    found = arena.run(np.tile(vector, (episodes, 1)), seeds)
    return _summary(task, found[:, :2].sum(axis=1), found[:, 0])


def _summary(task: Task, returns: Vector, plain: Vector) -> dict[str, Any]:
    plain_mean = float(plain.mean())
    return {
        "episodes": len(returns),
        "mean": float(returns.mean()),
        "std": float(returns.std()),
        "plain_mean": plain_mean,
        "success": plain_mean >= task.success,
    }


def replay(cell: Cell, circuit: Path | None = None) -> dict[str, Any]:
    """Return what a stored run's parameters do now, as ``score`` does."""
    task = find_task(cell.name.task)
    by_gradients = cell.name.agent in GRADIENTS and circuit is None
    agent = None if by_gradients else build_agent(task, cell.name.agent, cell.name.seed, circuit)
    return score(task, agent, cell.vector, cell.name.seed, cell.episodes)


def _arena(task: Task, agent: Policy | Net) -> "Arena | ParkingArena":
    return Arena(task, agent) if isinstance(task, Benchmark) else ParkingArena(task, agent)


def _command(name: Name, budget: BudgetName, circuit: Path | None) -> str:
    words = ["rover-ncp", "paper", "run", "--task", name.task, "--agent", name.agent]
    words += ["--seed", str(name.seed), "--budget", str(budget)]
    return shlex.join(words + (["--circuit", str(circuit)] if circuit else []))


def _versions(task: Task, *libraries: str) -> dict[str, str]:
    if isinstance(task, Benchmark):
        libraries = ("gymnasium", *libraries, *(("mujoco",) if task.mujoco else ()))
    return {library: metadata.version(library) for library in libraries}


def _thinned(found: Found) -> tuple[tuple[int, float], ...]:
    """Return a curve of at most some points, its ends among them."""
    curve = found.curve
    if len(curve) <= _CURVE_POINTS:
        return curve
    chosen = np.unique(np.linspace(0, len(curve) - 1, _CURVE_POINTS).round().astype(int))
    return tuple(curve[i] for i in chosen)
