"""Algorithm 1 of the paper, as printed: noise of one scale, which success enlarges and failure shrinks.

    f(theta) once; then in each iteration, with i = 0 at the beginning:
        theta' = theta + rand(sigma)
        f(theta') > f(theta): theta = theta', i = 0, sigma = sigma * alpha; otherwise sigma = sigma / alpha
        i = i + 1; if i > N: estimate f(theta) again

The scale has no limits, the start is not perturbed, and an estimate does not reset i. The paper gives neither
alpha nor N nor the first sigma; ours are below. The kinds of parameters differ in size by four orders of
magnitude, so sigma is a share of each one's range.
"""

import numpy as np
from numpy.typing import NDArray

from rover_ncp.circuit.policy import ParameterLayout
from sim.learn.search import Search
from sim.learn.search.random_search import Scale, climb_one_by_one
from sim.learn.search.unit_box import Vector

ALPHA = 1.05
ESTIMATE_AFTER = 100
"""Iterations without success after which the incumbent is estimated anew (the paper's N)."""
SIGMA = 0.05


class Algorithm1:
    """The rules of the algorithm."""

    counts_estimates = False

    def __init__(
        self, layout: ParameterLayout, *, alpha: float = ALPHA, sigma: float = SIGMA, estimates: bool = True
    ) -> None:
        """Without ``estimates`` none is due, for objectives without chance."""
        self._lower, self._upper = layout.lower, layout.upper
        self._alpha, self._estimates, self.start = alpha, estimates, Scale(sigma)

    def first(self, defaults: Vector, _: np.random.Generator) -> Vector:
        """Return the defaults."""
        return defaults

    def propose(self, incumbent: Vector, level: float, rng: np.random.Generator) -> Vector:
        """Add noise to every entry."""
        noise = level * (self._upper - self._lower) * rng.standard_normal(len(incumbent))
        vector: Vector = np.minimum(np.maximum(incumbent + noise, self._lower), self._upper)
        return vector

    def after(self, success: bool, scale: Scale) -> Scale:
        """Return the scale after a candidate. A success resets i before its iteration is counted."""
        if success:
            return Scale(scale.level * self._alpha, 1)
        count = scale.failures + 1
        return Scale(scale.level / self._alpha, count, self._estimates and count > ESTIMATE_AFTER)


def search(
    layout: ParameterLayout, defaults: Vector, rng: np.random.Generator, inert: NDArray[np.bool_]
) -> Search:
    """Search from the defaults (P,); inert parameters are changed like all others."""
    return climb_one_by_one(Algorithm1(layout), defaults, rng)
