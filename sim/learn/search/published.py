"""The search of the paper's published code: few random entries change, more of them after long failure.

An iteration gives each parameter kind a number of changes, uniform in 0..cap, and one standard deviation,
uniform in the kind's range. A change adds Gaussian noise to one entry of the kind, picked with replacement.
After 51 failures in a row every cap grows by one, after a success it shrinks by one. Unlike Algorithm 1's,
the scale of the noise never adapts. Constants: the published parking search.
"""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rover_ncp.circuit.circuit import ParameterKind
from rover_ncp.circuit.policy import ParameterLayout
from sim.learn.search import Search
from sim.learn.search.random_search import Scale, climb_one_by_one
from sim.learn.search.unit_box import Vector

LAYERS = (ParameterKind.INPUT_LAYER, ParameterKind.OUTPUT_LAYER)
FAILURES_TO_WIDEN = 51
"""Failures in a row after which every cap grows by one, and the count begins anew."""

_START_NOISE: Mapping[ParameterKind, tuple[int, float]] = {
    ParameterKind.WEIGHT: (15, 0.5),
    ParameterKind.SIGMA: (10, 0.2),
    ParameterKind.LEAK_POTENTIAL: (8, 8.0),
    ParameterKind.LEAK: (8, 0.2),
    ParameterKind.CAPACITANCE: (10, 0.1),
    # Parking has no layers. Ours: a layer's entries are weights too.
    ParameterKind.INPUT_LAYER: (15, 0.5),
    ParameterKind.OUTPUT_LAYER: (15, 0.5),
}
"""Changes of each kind at the start and their standard deviation."""


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


def perturb(layout: ParameterLayout, defaults: Vector, rng: np.random.Generator) -> Vector:
    """Return the defaults (P,) with noise on some entries of each kind, so that no two agents start alike."""
    vector = np.array(defaults, dtype=np.float64)
    for block in layout.blocks:
        changes, deviation = _START_NOISE[block.kind]
        entries = rng.integers(block.slice.start, block.slice.stop, changes)
        np.add.at(vector, entries, rng.normal(0.0, deviation, changes))
    return np.clip(vector, layout.lower, layout.upper)


class Published:
    """The published search of circuits: few entries change, more of them after long failure.

    The layers of a half-cheetah's circuit are drawn at random, and every entry of them changes each time.
    """

    def __init__(
        self,
        layout: ParameterLayout,
        rules: Mapping[ParameterKind, KindRule] = RULES,
        *,
        estimates: bool = True,
        counts_estimates: bool = False,
        falls_back: Mapping[int, int] = MappingProxyType({}),
    ) -> None:
        """``estimates``: 51 failures in a row make an estimate of the incumbent due."""
        self._lower, self._upper, self._layout = layout.lower, layout.upper, layout
        self.counts_estimates, self._estimates, self._falls_back = counts_estimates, estimates, falls_back
        blocks, self._rules = layout.blocks, [rules[block.kind] for block in layout.blocks]
        self._starts = np.array([block.slice.start for block in blocks])
        self._stops = np.array([block.slice.stop for block in blocks])
        self._low = np.array([rule.low for rule in self._rules])
        self._width = np.array([rule.high - rule.low for rule in self._rules])
        in_layer = [block.kind in LAYERS for block in blocks]
        self._layered = np.flatnonzero(np.repeat(in_layer, [block.size for block in blocks]))
        self.start = Scale([rule.first or rule.least for rule in self._rules])

    def first(self, defaults: Vector, rng: np.random.Generator) -> Vector:
        """Return the defaults with noise on some entries of each kind."""
        vector = perturb(self._layout, defaults, rng)
        vector[self._layered] = rng.standard_normal(len(self._layered))
        return np.minimum(np.maximum(vector, self._lower), self._upper)

    def propose(self, incumbent: Vector, level: Any, rng: np.random.Generator) -> Vector:
        """Draw the numbers of changes, the deviations, the entries and the noise, in this order."""
        counts = rng.integers(0, level, endpoint=True)
        deviations = self._low + self._width * rng.random(len(counts))
        entries = rng.integers(np.repeat(self._starts, counts), np.repeat(self._stops, counts))
        vector = incumbent.copy()
        np.add.at(vector, entries, np.repeat(deviations, counts) * rng.standard_normal(len(entries)))
        vector[self._layered] = incumbent[self._layered] + rng.standard_normal(len(self._layered))
        return np.minimum(np.maximum(vector, self._lower), self._upper)

    def after(self, success: bool, scale: Scale) -> Scale:
        """Shrink every cap after a success, and enlarge every cap after the 51st failure in a row."""
        pairs = list(zip(scale.level, self._rules, strict=True))
        if success:
            return Scale([max(cap - 1, rule.least) for cap, rule in pairs])
        if scale.failures + 1 < FAILURES_TO_WIDEN:
            return Scale(scale.level, scale.failures + 1)
        caps = [self._falls_back.get(cap, min(cap + 1, rule.most)) for cap, rule in pairs]
        return Scale(caps, due=self._estimates)


def search(
    layout: ParameterLayout, defaults: Vector, rng: np.random.Generator, inert: NDArray[np.bool_]
) -> Search:
    """Search from the perturbed defaults (P,); inert parameters are changed like all others."""
    return climb_one_by_one(Published(layout, estimates=False), defaults, rng)
