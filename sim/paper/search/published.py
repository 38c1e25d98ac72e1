"""The paper's own searches: Algorithm 1 as printed, and those of the published code.

``tests/kit/paper_reference.py`` has them literally; these make the same decisions in less time. Candidates
are drawn ahead, as if those before them had failed (``sim/learn/search/random_search.py``). Rollouts stop
where even the best possible rest would leave a candidate below its incumbent.

The published code has a search for each task. On parking, which has no chance, it is that of
``sim/learn/search/published.py``; the others also estimate the incumbent anew, which counts as an iteration.
Cart-pole has no published code and gets the pendulum's. MLP and LSTM have a search of their own.

The default budget of mountain car and cart-pole takes the published search too, and needs less time for the
same end. It starts from the best of many untuned agents, as some tasks reward nothing before the goal; it
prunes candidates that trail; and it stops at a return that is confirmed as enough, or at a plateau.
"""

import json
import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np

from rover_ncp.circuit.circuit import ParameterKind
from rover_ncp.circuit.policy import ParameterLayout, Policy
from rover_ncp.core.files import write_atomic
from sim.learn.engine.networks import Net
from sim.learn.run_folder import dump_checked, load_checked
from sim.learn.search.algorithm1 import ALPHA, ESTIMATE_AFTER, START_SCALE
from sim.learn.search.base import Vector
from sim.learn.search.published import FAILURES_TO_WIDEN, RULES, Caps, KindRule, Published
from sim.learn.search.random_search import RandomSearch
from sim.paper.agents import untuned
from sim.paper.evaluator import Evaluator
from sim.paper.search.estimate import (
    BenchmarkEstimator,
    Budget,
    Found,
    Point,
    best_start,
    confirmed,
    generator_of,
)
from sim.paper.search.parking import ParkingEvaluator

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
_MIN_AHEAD, _MAX_AHEAD = 3, 48
_AMPLITUDES = (0.01, 1.0)
"""Smallest and largest amplitude of a network's noise."""


class EstimateCaps(Caps):
    """Caps that grow when the incumbent was estimated anew, after 51 failures in a row."""

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


@dataclass(frozen=True)
class Sigma:
    """Algorithm 1's sigma, as a share of each parameter's range, and its counters."""

    sigma: float = START_SCALE
    i: int = 0
    due: bool = False
    """Whether the incumbent is to be estimated before the next candidate."""
    iterations: int = 0

    def after_success(self) -> Self:
        """Return a larger sigma."""
        return type(self)(self.sigma * ALPHA, 1, ESTIMATE_AFTER < 1, self.iterations + 1)

    def after_failure(self) -> Self:
        """Return a smaller sigma."""
        return type(self)(self.sigma / ALPHA, self.i + 1, self.i + 1 > ESTIMATE_AFTER, self.iterations + 1)


class Printed(RandomSearch[Sigma]):
    """Algorithm 1 as printed: sigma without limits, an exact start, estimates that take no iteration."""

    @staticmethod
    def first(layout: ParameterLayout, defaults: Vector, generator: np.random.Generator) -> Vector:
        """Return the defaults (P,)."""
        return defaults

    @property
    def iterations(self) -> int:
        """Candidates evaluated."""
        return self.adaptation.iterations

    def first_adaptation(self, layout: ParameterLayout) -> Sigma:
        """Return the first sigma."""
        return Sigma()

    def propose(self, adaptation: Sigma, generator: np.random.Generator) -> Vector:
        """Add noise to every entry."""
        noise = adaptation.sigma * (self.upper - self.lower) * generator.standard_normal(len(self.upper))
        return self.clip(self.incumbent + noise)

    def wants_estimate(self, adaptation: Sigma) -> bool:
        """Estimate after each iteration with i > N."""
        return adaptation.due

    def after_estimate(self, adaptation: Sigma) -> Sigma:
        """Go on; i stays."""
        return replace(adaptation, due=False)


@dataclass(frozen=True)
class Amplitude:
    """The amplitude of a network's noise, and the failures since it last grew."""

    amplitude: float = 0.01
    failures: int = 0

    def after_success(self) -> Self:
        """Halve the amplitude."""
        return type(self)(max(self.amplitude / 2.0, _AMPLITUDES[0]))

    def after_failure(self) -> Self:
        """Count a failure; the 51st makes the amplitude five times as large."""
        if self.failures + 1 < FAILURES_TO_WIDEN:
            return type(self)(self.amplitude, self.failures + 1)
        return type(self)(min(self.amplitude * 5.0, _AMPLITUDES[1]))


class PublishedOnNetworks(RandomSearch[Amplitude]):
    """The published search of MLP and LSTM: noise of one amplitude on all weights, which have no bounds."""

    def __init__(self, layout: ParameterLayout, start: Vector, generator: np.random.Generator) -> None:
        blocks = (block._replace(lower=-math.inf, upper=math.inf) for block in layout.blocks)
        super().__init__(ParameterLayout(tuple(blocks)), start, generator)

    @staticmethod
    def first(layout: ParameterLayout, defaults: Vector, generator: np.random.Generator) -> Vector:
        """Draw weights (P,) near zero."""
        return _AMPLITUDES[0] * generator.standard_normal(layout.size)

    def first_adaptation(self, layout: ParameterLayout) -> Amplitude:
        """Return the first amplitude."""
        return Amplitude()

    def propose(self, adaptation: Amplitude, generator: np.random.Generator) -> Vector:
        """Add noise to every weight."""
        return self.incumbent + adaptation.amplitude * generator.standard_normal(len(self.incumbent))


SEARCHES: Mapping[str, type[RandomSearch[Any]]] = {
    "published-parking": Published,
    "published-benchmarks": PublishedOnBenchmarks,
    "published-mountain-car": PublishedOnMountainCar,
    "published-network": PublishedOnNetworks,
    "algorithm1": Printed,
}


class Checkpoint:
    """The saved state of an unfinished run, or none; it holds all that a continued run depends on."""

    def __init__(self, path: Path | None, settings: dict[str, Any], every_s: float = 300.0) -> None:
        self._path, self._every_s = path, every_s
        self._owner = f"{path and path.name}\n{json.dumps(settings)}"
        self._began, self._worked, self._saved = time.monotonic(), time.process_time(), time.monotonic()
        self._before = (0.0, 0.0)

    def load(self) -> dict[str, Any] | None:
        """Return the state that was saved last. Raises FileError for a damaged file, or of another run."""
        if self._path is None or not self._path.is_file():
            return None
        data = load_checked(self._path, self._owner)
        self._before = data["wall_s"], data["cpu_s"]
        state: dict[str, Any] = data["search"]
        return state

    def times(self) -> tuple[float, float]:
        """Return wall time and CPU time in s, those before an interruption included."""
        wall_s, cpu_s = self._before
        return wall_s + time.monotonic() - self._began, cpu_s + time.process_time() - self._worked

    def save(self, state: Callable[[], dict[str, Any]]) -> None:
        """Write a state if the last one is old. Raises FileError."""
        if self._path is None or time.monotonic() - self._saved < self._every_s:
            return
        wall_s, cpu_s = self.times()
        data = {"wall_s": wall_s, "cpu_s": cpu_s, "search": state()}
        write_atomic(self._path, dump_checked(data, self._owner))
        self._saved = time.monotonic()


def search_from_one(
    evaluator: BenchmarkEstimator | ParkingEvaluator,
    agent: Policy | Net,
    seed: int,
    budget: Budget,
    checkpoint: Checkpoint,
) -> Found:
    """Search an agent's parameters from one incumbent. The same arguments give the same bits.

    Raises FileError if the state of an interrupted run does not fit.
    """
    generator, kind = generator_of(seed), SEARCHES[budget.strategy]
    if isinstance(evaluator, BenchmarkEstimator) and budget.starts > 1:
        starts = untuned(agent, generator, budget.starts)
        search = kind(agent.layout(), best_start(evaluator, starts, seed), generator)
    else:
        first = agent.parameters() if isinstance(agent, Policy) else agent.start(generator)
        search = kind.begin(agent.layout(), first, generator)
    curve: list[Point] = []
    ahead = _MIN_AHEAD
    if saved := checkpoint.load():
        search.restore(saved["search"])
        curve = [Point(*point) for point in saved["curve"]]
        ahead, evaluator.steps = int(saved["ahead"]), int(saved["steps"])

    def state() -> dict[str, Any]:
        return {"search": search.state(), "curve": curve, "ahead": ahead, "steps": evaluator.steps}

    while search.iterations < budget.evaluations:
        number, before = search.evaluations, search.value
        vectors = search.ask(min(ahead, budget.evaluations - search.iterations))
        search.tell(evaluator.estimate(vectors, number, search.to_beat))
        assert search.value is not None
        if budget.prunes and search.value >= evaluator.task.enough:
            assert isinstance(evaluator, Evaluator)
            search.value = confirmed(evaluator, search.incumbent, seed, search.evaluations)
        if search.value != before:
            curve.append(Point(search.iterations, evaluator.steps, search.value))
        ahead = min(2 * ahead, _MAX_AHEAD) if search.value == before else _MIN_AHEAD
        checkpoint.save(state)
        if budget.prunes and (ended := _ended(evaluator, search.value, search.iterations, curve, budget)):
            break
    else:
        ended = "evaluations"
    return Found(search.incumbent, search.evaluations, tuple(curve), ended)


def _ended(
    evaluator: BenchmarkEstimator | ParkingEvaluator,
    value: float,
    iterations: int,
    curve: list[Point],
    budget: Budget,
) -> str:
    """Return why a search of the default budget ends now, or nothing."""
    if value >= evaluator.task.enough:
        return "enough"
    if evaluator.steps >= budget.steps:
        return "steps"
    before = [point.value for point in curve if point.iterations <= iterations - budget.patience]
    return "plateau" if before and value <= before[-1] + 0.01 * abs(before[-1]) else ""
