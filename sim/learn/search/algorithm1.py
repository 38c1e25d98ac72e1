"""A search after Algorithm 1 of the paper: noise of one scale, which follows success and failure.

Success multiplies the scale by alpha, failure divides it by alpha; after N iterations without success the
incumbent's return is estimated anew, because it may have been lucky. The paper gives no numbers; ours are
below. The kinds differ in size by four orders of magnitude, so the scale is a fraction of each one's range.
"""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from rover_ncp.circuit.policy import ParameterLayout
from sim.learn.search.base import Strategy, Vector
from sim.learn.search.random_search import RandomSearch

ALPHA = 1.05
ESTIMATE_AFTER = 100
"""Iterations without success after which the incumbent is estimated anew (the paper's N)."""
START_SCALE = 0.05
# Taken literally, the rule balances only where every second candidate succeeds: the scale would shrink
# until adding the noise changes no bit. The floor keeps it a search; of 0.002, 0.005, 0.01 and 0.02 this one
# learned parking fastest (median of 12 agents after 500, 1000, 2000 and 4000 iterations, seed 500).
MIN_SCALE = 0.01
MAX_SCALE = 0.5


@dataclass(frozen=True)
class Scale:
    """The noise's scale as a fraction of each parameter's range, and the iterations without success."""

    scale: float = START_SCALE
    failures: int = 0

    def after_success(self) -> Self:
        """Return a greater scale."""
        return type(self)(min(self.scale * ALPHA, MAX_SCALE))

    def after_failure(self) -> Self:
        """Return a smaller scale."""
        return type(self)(max(self.scale / ALPHA, MIN_SCALE), self.failures + 1)


class Algorithm1(RandomSearch[Scale]):
    """Algorithm 1 with limits of its scale, and an estimate that counts as an iteration."""

    def first_adaptation(self, layout: ParameterLayout) -> Scale:
        """Return the first scale."""
        return Scale()

    def propose(self, adaptation: Scale, generator: np.random.Generator) -> Vector:
        """Add noise to every entry."""
        noise = adaptation.scale * (self.upper - self.lower) * generator.standard_normal(len(self.upper))
        return self.clip(self.incumbent + noise)

    def wants_estimate(self, adaptation: Scale) -> bool:
        """Every N iterations without success."""
        return adaptation.failures >= ESTIMATE_AFTER

    def after_estimate(self, adaptation: Scale) -> Scale:
        """Count the iterations without success anew; the scale stays."""
        return replace(adaptation, failures=0)


SEARCH: type[Strategy] = Algorithm1
