"""The search of the paper's published code: few random entries change, more of them after long failure.

An iteration gives each parameter kind a number of changes, uniform in 0..cap, and one standard deviation,
uniform in the kind's range. A change adds Gaussian noise to one entry of the kind, picked with replacement.
After 51 failures in a row every cap grows by one, after a success it shrinks by one. Unlike Algorithm 1's,
the scale of the noise never adapts. Constants: the published parking search.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import ClassVar, NamedTuple, Self

import numpy as np

from rover_ncp.circuit.circuit import ParameterKind
from rover_ncp.circuit.policy import ParameterLayout
from sim.learn.search.base import Strategy, Vector
from sim.learn.search.random_search import RandomSearch

FAILURES_TO_WIDEN = 51
"""Failures in a row after which every cap grows by one, and the count begins anew."""


class KindRule(NamedTuple):
    """The cap's range and the noise's range of one kind, and its first cap, 0 = the least."""

    least: int
    most: int
    low: float
    high: float
    first: int = 0


_WEIGHTS = KindRule(4, 12, 0.01, 0.4)

RULES: Mapping[ParameterKind, KindRule] = {
    # The noise is in the kind's own unit: S, 1/mV, mV, S, F.
    ParameterKind.WEIGHT: _WEIGHTS,
    ParameterKind.SIGMA: KindRule(3, 8, 0.01, 0.05),
    ParameterKind.LEAK_POTENTIAL: KindRule(2, 6, 0.1, 3.0),
    ParameterKind.LEAK: KindRule(2, 6, 0.05, 0.5),
    ParameterKind.CAPACITANCE: KindRule(2, 4, 0.01, 0.1),
    # Parking has no layers. Ours: a layer's entries are weights too.
    ParameterKind.INPUT_LAYER: _WEIGHTS,
    ParameterKind.OUTPUT_LAYER: _WEIGHTS,
}


@dataclass(frozen=True)
class Caps:
    """The largest number of changes of each kind in one iteration, and the failures since it last moved."""

    least: tuple[int, ...]
    most: tuple[int, ...]
    caps: tuple[int, ...]
    failures: int = 0

    def after_success(self) -> Self:
        """Shrink every cap by one, not below its least; count failures anew."""
        caps = tuple(max(cap - 1, least) for cap, least in zip(self.caps, self.least, strict=True))
        return replace(self, caps=caps, failures=0)

    def after_failure(self) -> Self:
        """Count a failure; with the 51st every cap grows by one, not above its most."""
        if self.failures + 1 < FAILURES_TO_WIDEN:
            # Not by ``replace``, which takes several times as long; every candidate comes here twice.
            return type(self)(self.least, self.most, self.caps, self.failures + 1)
        return self.widened()

    def widened(self) -> Self:
        """Grow every cap by one, not above its most; count failures anew."""
        caps = tuple(min(cap + 1, most) for cap, most in zip(self.caps, self.most, strict=True))
        return replace(self, caps=caps, failures=0)


class Published(RandomSearch[Caps]):
    """The published variant of the random search."""

    rules: ClassVar[Mapping[ParameterKind, KindRule]] = RULES
    caps: ClassVar[type[Caps]] = Caps

    def __init__(self, layout: ParameterLayout, start: Vector, generator: np.random.Generator) -> None:
        super().__init__(layout, start, generator)
        rules = [self.rules[block.kind] for block in layout.blocks]
        self._starts = np.array([block.slice.start for block in layout.blocks])
        self._stops = np.array([block.slice.stop for block in layout.blocks])
        self._low = np.array([rule.low for rule in rules])
        self._width = np.array([rule.high - rule.low for rule in rules])

    def first_adaptation(self, layout: ParameterLayout) -> Caps:
        """Return the first caps."""
        rules = [self.rules[block.kind] for block in layout.blocks]
        first = tuple(rule.first or rule.least for rule in rules)
        return self.caps(tuple(rule.least for rule in rules), tuple(rule.most for rule in rules), first)

    def propose(self, adaptation: Caps, generator: np.random.Generator) -> Vector:
        """Draw the numbers of changes, the deviations, the entries and the noise, in this order."""
        counts = generator.integers(0, adaptation.caps, endpoint=True)
        deviations = self._low + self._width * generator.random(len(counts))
        entries = generator.integers(np.repeat(self._starts, counts), np.repeat(self._stops, counts))
        vector = self.incumbent.copy()
        np.add.at(vector, entries, np.repeat(deviations, counts) * generator.standard_normal(len(entries)))
        return self.clip(vector)


SEARCH: type[Strategy] = Published
