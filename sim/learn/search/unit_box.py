"""The parameters that matter, each as a number in 0..1.

Bounds differ by four orders of magnitude between kinds; in the unit box a step of one size means about the
same to each. Leak conductances and capacitances are factors of a time constant and go by their logarithm.
"""

from decimal import Decimal
from functools import cache

import numpy as np
from numpy.typing import NDArray

from rover_ncp.circuit.circuit import ParameterKind
from rover_ncp.circuit.policy import ParameterLayout
from rover_ncp.circuit.solver import exp2
from rover_ncp.kernels.jit import kernel
from sim.learn.search.base import Vector

BY_LOGARITHM = frozenset({ParameterKind.LEAK, ParameterKind.CAPACITANCE})


class UnitBox:
    """Parameter vectors (P,) as points (D,) of the unit box, and back; ``inert`` parameters keep defaults.

    ``inert`` (P,) marks what no candidate's return depends on. The same bits on every machine.
    """

    def __init__(
        self, layout: ParameterLayout, defaults: Vector, inert: NDArray[np.bool_] | None = None
    ) -> None:
        self.lower, self.upper = layout.lower, layout.upper
        self.defaults = np.array(defaults, np.float64)
        self.free = np.flatnonzero(~inert) if inert is not None else np.arange(layout.size)
        # log2(upper / lower), or 0 where the scale is linear.
        doublings = np.zeros(layout.size)
        for block in layout.blocks:
            if block.kind in BY_LOGARITHM:
                doublings[block.slice] = _log2(block.upper / block.lower)
        # (3, D) lower, upper, doublings.
        self._scales = np.array([self.lower, self.upper, doublings])[:, self.free]

    @property
    def size(self) -> int:
        """D, the number of parameters that matter."""
        return len(self.free)

    @property
    def start(self) -> Vector:
        """(D,) where the defaults are."""
        values = self.defaults[self.free]
        return np.array(
            [
                _log2(value / lower) / doublings if doublings else (value - lower) / (upper - lower)
                for value, (lower, upper, doublings) in zip(
                    values.tolist(), self._scales.T.tolist(), strict=True
                )
            ]
        )

    def vectors(self, points: Vector) -> Vector:
        """Return the parameter vectors (n, P) of points (n, D)."""
        vectors = np.empty((len(points), len(self.defaults)))
        _write_values(points, self._scales, self.free, self.defaults, vectors)
        return vectors


def reflected(points: Vector) -> Vector:
    """Return points folded back into the unit box, as if its walls were mirrors."""
    folded = points - 2.0 * np.floor(points / 2.0)
    return np.minimum(folded, 2.0 - folded)


@cache
def _log2(value: float) -> float:
    """Return the logarithm, correctly rounded: libraries differ in the last bit."""
    return float(Decimal(value).ln() / Decimal(2).ln())


@kernel
def _write_values(
    points: Vector, scales: Vector, free: NDArray[np.int64], defaults: Vector, vectors: Vector
) -> None:
    for row in range(len(vectors)):
        vectors[row] = defaults
    for d in range(len(free)):
        lower, upper, doublings = scales[0, d], scales[1, d], scales[2, d]
        for row in range(len(points)):
            if doublings > 0.0:
                value = lower * exp2(points[row, d] * doublings)
            else:
                value = lower + points[row, d] * (upper - lower)
            vectors[row, free[d]] = min(max(value, lower), upper)
