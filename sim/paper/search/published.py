"""The paper's own searches with their budget: Algorithm 1 as printed, and that of the published code.

Every iteration of the paper's is done, and every decision is that of its estimates: all N rollouts, of which
the worst k count. Two things cost less than in the paper and change no decision. Candidates are drawn ahead,
as if those before them had failed (``sim/learn/search/random_search.py``). Rollouts stop where even the best
possible rest would leave a candidate below its incumbent.

The published code has a search for each task. On parking, which has no chance, it is that of
``sim/learn/search/published.py``; the others also estimate the incumbent anew. Cart-pole has no published
code and gets the pendulum's. A new estimate counts as an iteration here, at most one in 52.

A run takes seconds to hours, so it saves its state every few seconds; a run that continues from there gives
the same bits.
"""

import json
import math
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, ClassVar, Protocol, Self

import numpy as np

from rover_ncp.circuit.circuit import ParameterKind
from rover_ncp.circuit.policy import ParameterLayout, Policy
from rover_ncp.core.errors import FileError
from rover_ncp.core.files import read_text, write_atomic
from sim.learn.networks import Net
from sim.learn.search.base import Strategy, Vector, draw_seeds, dump_state
from sim.learn.search.published import FAILURES_TO_WIDEN, RULES, Caps, KindRule, Published
from sim.learn.search.strategies import start_search
from sim.paper.evaluator import Evaluator
from sim.paper.search.random import Budget, Found
from sim.paper.tasks import Benchmark

_CAR_WEIGHTS, _CAR_WEIGHTS_AGAIN = 16, 12
"""Largest cap of a car's weights, and the one that follows it."""
_CAR_RULES: Mapping[ParameterKind, KindRule] = {
    **RULES,
    ParameterKind.WEIGHT: KindRule(6, _CAR_WEIGHTS, 0.01, 0.8),
    ParameterKind.SIGMA: KindRule(5, 12, 0.01, 0.08),
    ParameterKind.LEAK_POTENTIAL: KindRule(4, 8, 0.1, 3.0),
    ParameterKind.LEAK: KindRule(4, 8, 0.05, 0.8),
    ParameterKind.CAPACITANCE: KindRule(4, 7, 0.01, 0.3),
}
_LAYERS = (ParameterKind.INPUT_LAYER, ParameterKind.OUTPUT_LAYER)
# Streams of random numbers.
_SEARCH, _ROLLOUTS = range(2)
_LEAST_AHEAD, _MOST_AHEAD = 3, 48
_SAVE_EVERY_S = 10.0
_STOPS = (1, 3, 9)
"""Rollouts after which candidates may be rejected."""


class EstimateCaps(Caps):
    """Caps that grow when the incumbent was estimated anew, after 51 failures in a row."""

    most_failures: ClassVar[int] = FAILURES_TO_WIDEN

    def after_failure(self) -> Self:
        """Count a failure."""
        return type(self)(self.least, self.most, self.caps, self.failures + 1)


class CarCaps(EstimateCaps):
    """Caps of the mountain car's search, where that of the weights falls back when it is at its most."""

    def widened(self) -> Self:
        """Grow every cap by one; count failures anew."""
        caps = super().widened().caps
        back = [cap == _CAR_WEIGHTS for cap in self.caps]
        return replace(
            self,
            caps=tuple(_CAR_WEIGHTS_AGAIN if b else cap for cap, b in zip(caps, back, strict=True)),
            failures=0,
        )


class PublishedOnBenchmarks(Published):
    """The published search of pendulum and half-cheetah.

    The layers of a half-cheetah's circuit are drawn at random, and every entry of them changes each time.
    """

    caps: ClassVar[type[Caps]] = EstimateCaps

    def __init__(self, layout: ParameterLayout, start: Vector, generator: np.random.Generator) -> None:
        kinds = [block.kind for block in layout.blocks]
        # A network's parameters are layers too, and nothing else.
        layered = ParameterKind.WEIGHT in kinds and ParameterKind.INPUT_LAYER in kinds
        changed = np.zeros(layout.size, np.bool_)
        for kind in _LAYERS if layered else ():
            changed[layout.block(kind).slice] = True
        self._layered = np.flatnonzero(changed)
        start = start.copy()
        start[self._layered] = generator.standard_normal(len(self._layered))
        super().__init__(layout, np.clip(start, layout.lower, layout.upper), generator)

    def propose(self, adaptation: Caps, generator: np.random.Generator) -> Vector:
        """Draw the changes, and then those of the layers."""
        vector = super().propose(adaptation, generator)
        vector[self._layered] = self.incumbent[self._layered] + generator.standard_normal(len(self._layered))
        return self.clip(vector)

    def wants_estimate(self, adaptation: Caps) -> bool:
        """Estimate after 51 failures."""
        return adaptation.failures == FAILURES_TO_WIDEN

    def after_estimate(self, adaptation: Caps) -> Caps:
        """Widen the caps."""
        return adaptation.widened()


class PublishedOnMountainCar(PublishedOnBenchmarks):
    """The published search of mountain car, with larger changes and more of them."""

    rules: ClassVar[Mapping[ParameterKind, KindRule]] = _CAR_RULES
    caps: ClassVar[type[Caps]] = CarCaps


_OWN_SEARCHES: Mapping[str, type[Strategy]] = {
    "published-benchmarks": PublishedOnBenchmarks,
    "published-mountain-car": PublishedOnMountainCar,
}


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
    own = _OWN_SEARCHES.get(budget.strategy)
    search: Strategy = (
        start_search(budget.strategy, agent.layout(), first, generator)
        if own is None
        else own.begin(agent.layout(), first, generator)
    )
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
