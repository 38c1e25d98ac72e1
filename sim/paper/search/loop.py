"""The loops of the searches, and the checkpoint of an unfinished one.

The default budget of benchmarks takes the published search too, and needs less time for the same end: it
starts from the best of many untuned agents, as some tasks reward nothing before the goal, prunes candidates
that trail, and stops at a plateau or a return that is confirmed as enough. That of parking is the project's
own Gauss-Newton search, alike for all agents.
"""

import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from rover_ncp.circuit.compiled import dead_parameters
from rover_ncp.circuit.policy import Policy
from rover_ncp.core.files import write_atomic
from sim.learn.engine.networks import Net
from sim.learn.run_folder import dump_checked, load_checked
from sim.learn.search.base import Vector, draw_seeds
from sim.learn.search.strategies import start_search
from sim.paper.agents import first_vector, untuned
from sim.paper.search.estimate import BenchmarkEstimator, Budget, Estimator, Found, ParkingEvaluator, Point
from sim.paper.search.published import SEARCHES

# Streams of random numbers; another one is that of ``estimate.py``.
_SEARCH, _, _STARTS, _CONFIRM = range(4)
_START_ROUNDS = (1, 2, 4, 8, 16)
"""Episodes of each start in a round; a quarter of the starts goes on to the next round."""
_CONFIRMATIONS = 100
_PATIENCE = 15_000
"""Iterations without a gain of a hundredth that are a plateau."""
_MIN_AHEAD, _MAX_AHEAD = 3, 48


class Checkpoint:
    """The saved state of an unfinished run, or none; it holds all that a continued run depends on."""

    def __init__(self, path: Path | None, settings: dict[str, Any], every_s: float = 300.0) -> None:
        self._path, self._every_s = path, every_s
        self._owner = f"{path and path.name}\n{json.dumps(settings)}"
        self._began = np.array([time.monotonic(), time.process_time()])
        self._saved = time.monotonic()

    def load(self) -> dict[str, Any] | None:
        """Return the state that was saved last. Raises FileError for a damaged file, or of another run."""
        if self._path is None or not self._path.is_file():
            return None
        data = load_checked(self._path, self._owner)
        self._began -= data["times"]
        state: dict[str, Any] = data["search"]
        return state

    def times(self) -> list[float]:
        """Return wall time and CPU time in s, those before an interruption included."""
        times: list[float] = ([time.monotonic(), time.process_time()] - self._began).tolist()
        return times

    def save(self, state: Callable[[], dict[str, Any]]) -> None:
        """Write a state if the last one is old. Raises FileError."""
        if self._path is None or time.monotonic() - self._saved < self._every_s:
            return
        write_atomic(self._path, dump_checked({"times": self.times(), "search": state()}, self._owner))
        self._saved = time.monotonic()


def search_from_one(
    estimator: Estimator, agent: Policy | Net, seed: int, budget: Budget, checkpoint: Checkpoint
) -> Found:
    """Search an agent's parameters from one incumbent. The same arguments give the same bits.

    Raises FileError if the state of an interrupted run does not fit.
    """
    generator, kind = _generator(seed), SEARCHES[budget.strategy]
    if isinstance(estimator, BenchmarkEstimator) and budget.starts > 1:
        starts = untuned(agent, generator, budget.starts)
        search = kind(agent.layout(), best_start(estimator, starts, seed), generator)
    else:
        search = kind.begin(agent.layout(), first_vector(agent, generator), generator)
    curve: list[Point] = []
    ahead, ended = _MIN_AHEAD, ""
    if saved := checkpoint.load():
        search.restore(saved["search"])
        curve = [Point(*point) for point in saved["curve"]]
        ahead, estimator.steps = int(saved["ahead"]), int(saved["steps"])

    def state() -> dict[str, Any]:
        return {"search": search.state(), "curve": curve, "ahead": ahead, "steps": estimator.steps}

    while not ended:
        number, before = search.evaluations, search.value
        vectors = search.ask(min(ahead, budget.evaluations - search.iterations))
        search.tell(estimator.estimate(vectors, number, search.to_beat))
        assert search.value is not None
        if budget.prunes and search.value >= estimator.task.default.enough:
            assert isinstance(estimator, BenchmarkEstimator)
            search.value = confirmed(estimator, search.incumbent, seed, search.evaluations)
        if search.value != before:
            curve.append(Point(search.iterations, estimator.steps, search.value))
        ahead = min(2 * ahead, _MAX_AHEAD) if search.value == before else _MIN_AHEAD
        checkpoint.save(state)
        ended = _spent(budget, search.iterations, estimator.steps)
        if budget.prunes and search.value >= estimator.task.default.enough:
            ended = "enough"
        elif budget.prunes and not ended and _is_flat(curve, search.iterations):
            ended = "plateau"
    return Found(search.incumbent, search.evaluations, tuple(curve), ended)


def _spent(budget: Budget, iterations: int, steps: int) -> str:
    """Return which limit of a budget is reached, or nothing."""
    if iterations >= budget.evaluations:
        return "evaluations"
    return "steps" if steps >= budget.steps else ""


def _is_flat(curve: list[Point], iterations: int) -> bool:
    before = [point.value for point in curve if point.iterations <= iterations - _PATIENCE]
    return bool(before) and curve[-1].value <= before[-1] + 0.01 * abs(before[-1])


def best_start(evaluator: BenchmarkEstimator, starts: Vector, seed: int) -> Vector:
    """Return the best (P,) of many starts (n, P)."""
    left, total = np.arange(len(starts)), np.zeros(len(starts))
    for number, rollouts in enumerate(_START_ROUNDS):
        seeds = draw_seeds(seed, (_STARTS, number), rollouts)
        total[left] += evaluator.returns(starts[left], seeds).sum(axis=1)
        left = left[np.argsort(-total[left], kind="stable")][: -(-len(left) // 4)]
    best: Vector = starts[left[0]]
    return best


def confirmed(evaluator: BenchmarkEstimator, vector: Vector, seed: int, evaluation: int) -> float:
    """Return the mean return of many fresh rollouts."""
    seeds = draw_seeds(seed, (_CONFIRM, evaluation), _CONFIRMATIONS)
    return float(evaluator.returns(vector[None], seeds).mean())


def search_parking(evaluator: ParkingEvaluator, agent: Policy | Net, seed: int, budget: Budget) -> Found:
    """Search an agent's parameters on the parking course. The same arguments give the same bits.

    A return says little about whether the rover stands at the end. So the result is the best candidate that
    parks, if any does.
    """
    generator = _generator(seed)
    inert = dead_parameters(agent) if isinstance(agent, Policy) else None
    first = first_vector(agent, generator)
    search = start_search("gauss-newton", agent.layout(), first, generator, inert)
    curve: list[Point] = []
    ended, parks = "", None
    while not ended:
        ahead = min(search.max_ahead, budget.evaluations - search.evaluations)
        vectors, before = search.ask(ahead), search.value
        values, counted, residuals = evaluator.traces(vectors)
        search.tell(counted, residuals)
        ended = _spent(budget, search.evaluations, evaluator.steps)
        if search.value == before:
            continue
        best = float(values[int(np.argmax(counted))])
        curve.append(Point(search.evaluations, evaluator.steps, best))
        if best >= evaluator.task.success and evaluator.outcome(search.incumbent)[1]:
            parks = search.incumbent
            if best >= evaluator.task.default.enough:
                ended = "enough"
    return Found(search.incumbent if parks is None else parks, search.evaluations, tuple(curve), ended)


def _generator(seed: int) -> np.random.Generator:
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence(seed, spawn_key=(_SEARCH,))))
