"""The paper's own searches with their budget: Algorithm 1 as printed, and that of the published code.

Every iteration of the paper's is done, and every decision is that of its estimates: all N rollouts, of which
the worst k count. Two things cost less than in the paper and change no decision. Candidates are drawn ahead,
as if those before them had failed (``sim/learn/search/random_search.py``). Rollouts stop where even the best
possible rest would leave a candidate below its incumbent.

A run takes minutes to hours, so it saves its state every few seconds; a run that continues from there gives
the same bits.
"""

import json
import math
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from rover_ncp.circuit.policy import Policy
from rover_ncp.core.errors import FileError
from rover_ncp.core.files import read_text, write_atomic
from sim.learn.networks import Net
from sim.learn.search.base import Vector, draw_seeds, dump_state
from sim.learn.search.strategies import start_search
from sim.paper.evaluator import Evaluator
from sim.paper.random_search import Budget, Found
from sim.paper.tasks import Benchmark

# Streams of random numbers.
_SEARCH, _ROLLOUTS = range(2)
_LEAST_AHEAD, _MOST_AHEAD = 3, 48
_SAVE_EVERY_S = 10.0
_STOPS = (1, 3, 9)
"""Rollouts after which candidates may be rejected."""


class Estimator(Protocol):
    """Estimates the returns of candidates, and counts the steps that it takes."""

    steps: int

    def estimate(self, vectors: Vector, number: int, to_beat: Vector) -> Vector:
        """Return the estimates (k,) of vectors (k, P), exact where they exceed ``to_beat`` (k,).

        ``number`` is that of the first one among all evaluations.
        """


class Partial:
    """The file of a run that has not ended, or none; it holds all that a continued run depends on."""

    def __init__(self, path: Path | None, settings: dict[str, Any]) -> None:
        self._path, self._settings = path, json.loads(json.dumps(settings))
        self._began, self._worked, self._saved = time.monotonic(), time.process_time(), time.monotonic()
        self._before = (0.0, 0.0)

    def load(self) -> dict[str, Any] | None:
        """Return the state that was saved last. Raises FileError for a damaged file, or other settings."""
        if self._path is None or not self._path.is_file():
            return None
        data = _read(self._path)
        if data["settings"] != self._settings:
            raise FileError(f"{self._path}: a run with other settings; delete it to begin anew")
        self._before = float(data["wall_s"]), float(data["cpu_s"])
        return dict(data["state"])

    def times(self) -> tuple[float, float]:
        """Return wall time and CPU time in s, those before an interruption included."""
        wall_s, cpu_s = self._before
        return wall_s + time.monotonic() - self._began, cpu_s + time.process_time() - self._worked

    def save(self, state: Callable[[], dict[str, Any]]) -> None:
        """Write a state if the last one is old. Raises FileError."""
        if self._path is None or time.monotonic() - self._saved < _SAVE_EVERY_S:
            return
        wall_s, cpu_s = self.times()
        data = {"settings": self._settings, "wall_s": wall_s, "cpu_s": cpu_s, "state": state()}
        write_atomic(self._path, dump_state(data) + "\n")
        self._saved = time.monotonic()


def search_as_published(
    evaluator: Estimator, agent: Policy | Net, seed: int, budget: Budget, partial: Partial
) -> Found:
    """Search an agent's parameters to the last iteration. The same arguments give the same bits.

    Raises FileError if the state of an interrupted run does not fit.
    """
    generator = np.random.Generator(np.random.PCG64(np.random.SeedSequence(seed, spawn_key=(_SEARCH,))))
    first = agent.parameters() if isinstance(agent, Policy) else agent.start(generator)
    search = start_search(budget.strategy, agent.layout(), first, generator)
    curve: list[tuple[int, float]] = []
    ahead = _LEAST_AHEAD
    if saved := partial.load():
        search.restore(saved["search"])
        curve = [(int(iteration), float(value)) for iteration, value in saved["curve"]]
        ahead, evaluator.steps = int(saved["ahead"]), int(saved["steps"])

    def state() -> dict[str, Any]:
        return {"search": search.state(), "curve": curve, "ahead": ahead, "steps": evaluator.steps}

    while search.iterations < budget.evaluations:
        number, before = search.evaluations, search.value
        vectors = search.ask(min(ahead, budget.evaluations - search.iterations))
        search.tell(evaluator.estimate(vectors, number, search.to_beat))
        assert search.value is not None
        if search.value != before:
            curve.append((search.iterations, search.value))
        ahead = min(2 * ahead, _MOST_AHEAD) if search.value == before else _LEAST_AHEAD
        partial.save(state)
    return Found(search.incumbent, search.evaluations, tuple(curve), "evaluations")


def read_partial(path: Path) -> dict[str, Any]:
    """Return how far a run that has not ended has come: iterations of how many, estimate, CPU time in s."""
    data = _read(path)
    iterations, of = data["state"]["search"]["evaluations"] - 1, data["settings"]["evaluations"]
    return {
        "iterations": iterations,  #: that were made
        "of": of,  #: of how many
        "estimate": data["state"]["curve"][-1][1],  #: of the incumbent
        "cpu_s": data["cpu_s"],  #: so far
        "hours_to_run": data["cpu_s"] / max(iterations, 1) * of / 3600.0,  #: of a whole run, on one core
    }


def _read(path: Path) -> dict[str, Any]:
    """Read a partial run. Raises FileError for a damaged file."""
    try:
        data: dict[str, Any] = json.loads(read_text(path))
        if {"settings", "wall_s", "cpu_s", "state"} <= set(data) and {"search", "curve"} <= set(
            data["state"]
        ):
            return data
        raise ValueError("keys are missing")
    except (ValueError, TypeError) as error:
        raise FileError(f"{path}: damaged; delete it to begin the run anew") from error


class BenchmarkEstimator(Evaluator):
    """The paper's estimate on a benchmark: the mean of the worst k of N rollouts."""

    def __init__(self, task: Benchmark, agent: Policy | Net, seed: int, budget: Budget) -> None:
        super().__init__(task, agent, for_search=True)
        self._seed, self._rollouts, self._worst = seed, budget.rollouts, budget.worst
        # Without an upper bound of a return no candidate can be rejected early.
        early = [stop for stop in _STOPS if stop < budget.rollouts and math.isfinite(task.most)]
        self._stops = [*early, budget.rollouts]

    def estimate(self, vectors: Vector, number: int, to_beat: Vector) -> Vector:
        """Return the estimates (k,) of vectors (k, P), exact where they exceed ``to_beat`` (k,)."""
        keys = [(_ROLLOUTS, number + place) for place in range(len(vectors))]
        seeds = np.array([draw_seeds(self._seed, key, self._rollouts) for key in keys])
        # Rollouts that are still to come count as the best possible: an upper bound of the estimate.
        returns = np.full((len(vectors), self._rollouts), self.task.most)
        bounds = np.full(len(vectors), np.inf)
        left, done = np.arange(len(vectors)), 0
        for stop in self._stops:
            found = self.run(np.repeat(vectors[left], stop - done, axis=0), seeds[left, done:stop].ravel())
            returns[left, done:stop] = found[:, :2].sum(axis=1).reshape(len(left), -1)
            lowest = np.sort(returns[left], axis=1)[:, : self._worst]
            bounds[left] = [math.fsum(row) / self._worst for row in lowest]
            left, done = left[bounds[left] > to_beat[left]], stop
            if not len(left):
                break
        return bounds
