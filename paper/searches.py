"""The paper's own searches: Algorithm 1 as printed, and those of the published code.

``tests/kit/paper_reference.py`` has them literally; these make the same decisions in less time. Candidates
are drawn ahead, as if those before them had failed (``sim/learn/search/random_search.py``).

The published code has a search for each task. On parking, which has no chance, it is that of
``sim/learn/search/published.py``; the others also estimate the incumbent anew. MLP and LSTM have a search of
their own. That of cart-pole is in an older commit of the published code (529dae8), where an estimate counts
as an iteration.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Self

import numpy as np

from rover_ncp.circuit.circuit import ParameterKind
from rover_ncp.circuit.policy import ParameterLayout
from sim.learn.search.algorithm1 import ALPHA, ESTIMATE_AFTER, START_SCALE
from sim.learn.search.base import Vector
from sim.learn.search.published import FAILURES_TO_WIDEN, RULES, Caps, KindRule, Published
from sim.learn.search.random_search import RandomSearch

_CAR_WEIGHTS, _CAR_WEIGHTS_AGAIN = 16, 12
"""Largest cap of a car's weights, and the one that follows it."""
_CAR_RULES: Mapping[ParameterKind, KindRule] = {
    **RULES,
    ParameterKind.WEIGHT: KindRule(6, _CAR_WEIGHTS, 0.01, 0.8),
    ParameterKind.SIGMA: KindRule(5, 12, 0.01, 0.08),
    ParameterKind.LEAK_POTENTIAL: KindRule(4, 8, 0.1, 3.0, first=5),
    ParameterKind.LEAK: KindRule(4, 8, 0.05, 0.8),
    ParameterKind.CAPACITANCE: KindRule(4, 7, 0.01, 0.3),
}
_CART_RULES: Mapping[ParameterKind, KindRule] = {
    **RULES,
    ParameterKind.WEIGHT: KindRule(5, 12, 0.03, 0.3, first=4),
    ParameterKind.LEAK_POTENTIAL: KindRule(3, 8, 0.1, 2.0, first=2),
    ParameterKind.LEAK: KindRule(2, 6, 0.02, 0.2),
}
_LAYERS = (ParameterKind.INPUT_LAYER, ParameterKind.OUTPUT_LAYER)
_MIN_AMPLITUDE, _MAX_AMPLITUDE = 0.01, 1.0
"""Of a network's noise."""


@dataclass(frozen=True)
class EstimateCaps(Caps):
    """Caps that grow when 51 failures in a row make a new estimate of the incumbent due."""

    due: bool = False
    iterations: int = 0

    def after_success(self) -> Self:
        return replace(super().after_success(), due=False, iterations=self.iterations + 1)

    def after_failure(self) -> Self:
        if self.failures + 1 < FAILURES_TO_WIDEN:
            counts = self.failures + 1, False, self.iterations + 1
            return type(self)(self.least, self.most, self.caps, *counts)
        return replace(self.widened(), due=True, iterations=self.iterations + 1)


class CarCaps(EstimateCaps):
    """Caps of the mountain car's search, where that of the weights falls back when it is at its most."""

    def widened(self) -> Self:
        wide = super().widened()
        pairs = zip(self.caps, wide.caps, strict=True)
        return replace(
            wide, caps=tuple(_CAR_WEIGHTS_AGAIN if old == _CAR_WEIGHTS else new for old, new in pairs)
        )


class _Estimating(RandomSearch[Any]):
    """A search whose adaptation says when an estimate of the incumbent is ``due``; it takes no iteration."""

    @property
    def iterations(self) -> int:
        return int(self.adaptation.iterations)

    def wants_estimate(self, adaptation: Any) -> bool:
        return bool(adaptation.due)

    def after_estimate(self, adaptation: Any) -> Any:
        return replace(adaptation, due=False)


class PublishedOnBenchmarks(_Estimating, Published):
    """The published search of pendulum and half-cheetah.

    The layers of a half-cheetah's circuit are drawn at random, and every entry of them changes each time.
    """

    caps: ClassVar[type[Caps]] = EstimateCaps

    def __init__(self, layout: ParameterLayout, start: Vector, generator: np.random.Generator) -> None:
        in_layer = [block.kind in _LAYERS for block in layout.blocks]
        self._layered = np.flatnonzero(np.repeat(in_layer, [block.size for block in layout.blocks]))
        start = start.copy()
        start[self._layered] = generator.standard_normal(len(self._layered))
        super().__init__(layout, np.clip(start, layout.lower, layout.upper), generator)

    def propose(self, adaptation: Caps, generator: np.random.Generator) -> Vector:
        vector = super().propose(adaptation, generator)
        vector[self._layered] = self.incumbent[self._layered] + generator.standard_normal(len(self._layered))
        return self.clip(vector)


class PublishedOnMountainCar(PublishedOnBenchmarks):
    """The published search of mountain car, with larger changes and more of them."""

    rules: ClassVar[Mapping[ParameterKind, KindRule]] = _CAR_RULES
    caps: ClassVar[type[Caps]] = CarCaps


class PublishedOnCartPole(PublishedOnBenchmarks):
    """The published search of cart-pole, whose estimates take an iteration each."""

    rules: ClassVar[Mapping[ParameterKind, KindRule]] = _CART_RULES
    iterations = RandomSearch.iterations


@dataclass(frozen=True)
class Sigma:
    """Algorithm 1's sigma, as a share of each parameter's range, and its counters."""

    sigma: float = START_SCALE
    i: int = 0
    due: bool = False
    """Whether the incumbent is to be estimated before the next candidate."""
    iterations: int = 0

    def after_success(self) -> Self:
        return type(self)(self.sigma * ALPHA, 1, False, self.iterations + 1)

    def after_failure(self) -> Self:
        return type(self)(self.sigma / ALPHA, self.i + 1, self.i + 1 > ESTIMATE_AFTER, self.iterations + 1)


class Printed(_Estimating):
    """Algorithm 1 as printed: sigma without limits, an exact start, estimates that take no iteration."""

    @staticmethod
    def first(layout: ParameterLayout, defaults: Vector, generator: np.random.Generator) -> Vector:
        return defaults

    def first_adaptation(self, layout: ParameterLayout) -> Sigma:
        return Sigma()

    def propose(self, adaptation: Sigma, generator: np.random.Generator) -> Vector:
        noise = adaptation.sigma * (self.upper - self.lower) * generator.standard_normal(len(self.upper))
        return self.clip(self.incumbent + noise)


@dataclass(frozen=True)
class Amplitude:
    """The amplitude of a network's noise; 51 failures in a row make it grow, and an estimate due."""

    amplitude: float = _MIN_AMPLITUDE
    failures: int = 0
    due: bool = False
    iterations: int = 0

    def after_success(self) -> Self:
        return type(self)(max(self.amplitude / 2.0, _MIN_AMPLITUDE), iterations=self.iterations + 1)

    def after_failure(self) -> Self:
        if self.failures + 1 < FAILURES_TO_WIDEN:
            return type(self)(self.amplitude, self.failures + 1, False, self.iterations + 1)
        grown = min(self.amplitude * 5.0, _MAX_AMPLITUDE)
        return type(self)(grown, due=True, iterations=self.iterations + 1)


class PublishedOnNetworks(_Estimating):
    """The published search of MLP and LSTM: noise of one amplitude on all weights, which have no bounds."""

    def __init__(self, layout: ParameterLayout, start: Vector, generator: np.random.Generator) -> None:
        blocks = (block._replace(lower=-math.inf, upper=math.inf) for block in layout.blocks)
        super().__init__(ParameterLayout(tuple(blocks)), start, generator)

    @staticmethod
    def first(layout: ParameterLayout, defaults: Vector, generator: np.random.Generator) -> Vector:
        return _MIN_AMPLITUDE * generator.standard_normal(layout.size)

    def first_adaptation(self, layout: ParameterLayout) -> Amplitude:
        return Amplitude()

    def propose(self, adaptation: Amplitude, generator: np.random.Generator) -> Vector:
        return self.incumbent + adaptation.amplitude * generator.standard_normal(len(self.incumbent))


SEARCHES: Mapping[str, type[RandomSearch[Any]]] = {
    "published-parking": Published,
    "published-benchmarks": PublishedOnBenchmarks,
    "published-mountain-car": PublishedOnMountainCar,
    "published-cart-pole": PublishedOnCartPole,
    "published-network": PublishedOnNetworks,
    "algorithm1": Printed,
}
