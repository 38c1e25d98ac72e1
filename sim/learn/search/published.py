"""The search of the paper's published code: few random entries change, more of them after long failure.

An iteration gives each parameter kind a number of changes, uniform in 0..cap, and one standard deviation,
uniform in the kind's range. A change adds Gaussian noise to one entry of the kind, picked with replacement.
After 51 failures in a row every cap grows by one, after a success it shrinks by one. Unlike Algorithm 1's,
the scale of the noise never adapts. Constants: the published parking search.
"""

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rover_ncp.circuit.circuit import ParameterKind
from rover_ncp.circuit.policy import ParameterLayout
from sim.learn.search import Batch, Search
from sim.learn.search.unit_box import Vector

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


class Changes:
    """Draws candidates near an incumbent, by the rule of each kind."""

    def __init__(self, layout: ParameterLayout, rules: Mapping[ParameterKind, KindRule]) -> None:
        self.rules = [rules[block.kind] for block in layout.blocks]
        self._lower, self._upper = layout.lower, layout.upper
        self._starts = np.array([block.slice.start for block in layout.blocks])
        self._stops = np.array([block.slice.stop for block in layout.blocks])
        self._low = np.array([rule.low for rule in self.rules])
        self._width = np.array([rule.high - rule.low for rule in self.rules])

    def draw(self, incumbent: Vector, caps: Sequence[int], rng: np.random.Generator) -> Vector:
        """Draw the numbers of changes, the deviations, the entries and the noise, in this order."""
        counts = rng.integers(0, caps, endpoint=True)
        deviations = self._low + self._width * rng.random(len(counts))
        entries = rng.integers(np.repeat(self._starts, counts), np.repeat(self._stops, counts))
        vector = incumbent.copy()
        np.add.at(vector, entries, np.repeat(deviations, counts) * rng.standard_normal(len(entries)))
        return np.clip(vector, self._lower, self._upper)


def search(
    layout: ParameterLayout, defaults: Vector, rng: np.random.Generator, inert: NDArray[np.bool_]
) -> Search:
    """Search from the perturbed defaults (P,); inert parameters are changed like all others."""
    changes = Changes(layout, RULES)
    caps, failures = [rule.least for rule in changes.rules], 0
    incumbent = perturb(layout, defaults, rng)
    value = (yield Batch(incumbent[None].copy(), np.array([-math.inf]))).returns[0]
    while True:
        candidate = changes.draw(incumbent, caps, rng)
        found = (yield Batch(candidate[None].copy(), np.array([value]))).returns[0]
        failures += 1
        if found > value:
            incumbent, value, failures = candidate, found, 0
            caps = [max(cap - 1, rule.least) for cap, rule in zip(caps, changes.rules, strict=True)]
        elif failures == FAILURES_TO_WIDEN:
            failures = 0
            caps = [min(cap + 1, rule.most) for cap, rule in zip(caps, changes.rules, strict=True)]
