"""What random searches share: one incumbent, and candidates whose distance follows success and failure."""

import math
from typing import Any, NamedTuple, Protocol

import numpy as np

from sim.learn.search import Batch, Search
from sim.learn.search.unit_box import Vector


class Scale(NamedTuple):
    """How far candidates are from the incumbent: caps of changes, a sigma, or an amplitude."""

    level: Any
    failures: int = 0
    """In a row."""
    due: bool = False
    """Whether the incumbent is estimated anew before the next candidate."""


class Strategy(Protocol):
    """How a search draws its candidates, and how success and failure change their distance."""

    counts_estimates: bool
    """Whether a new estimate of the incumbent is an iteration."""
    start: Scale

    def first(self, defaults: Vector, rng: np.random.Generator) -> Vector:
        """Return the first incumbent (P,)."""

    def propose(self, incumbent: Vector, level: Any, rng: np.random.Generator) -> Vector:
        """Draw a candidate (P,): a new array."""

    def after(self, success: bool, scale: Scale) -> Scale:
        """Return the scale after a candidate that was better than the incumbent, or was not."""


def climb_one_by_one(strategy: Strategy, defaults: Vector, rng: np.random.Generator) -> Search:
    """Search from a strategy's first incumbent, with one candidate in a batch."""
    incumbent, scale = strategy.first(defaults, rng), strategy.start
    value = (yield Batch(incumbent[None].copy(), np.array([-math.inf]))).returns[0]
    while True:
        if scale.due:
            value = (yield Batch(incumbent[None].copy(), np.array([-math.inf]))).returns[0]
        candidate = strategy.propose(incumbent, scale.level, rng)
        found = (yield Batch(candidate[None].copy(), np.array([value]))).returns[0]
        success = bool(found > value)
        if success:
            incumbent, value = candidate, found
        scale = strategy.after(success, scale)
