"""Search spaces as unit boxes: each free parameter is a number in 0..1.

Bounds differ by four orders of magnitude between kinds; in the unit box a step of one size means about the
same to each. Parameters that act as factors, such as those of a time constant, go by their logarithm.
"""

from typing import Self

import numpy as np
from numpy.typing import NDArray

from rover_ncp.circuit.circuit import ParameterKind
from rover_ncp.circuit.policy import ParameterLayout

FACTORS = (ParameterKind.LEAK, ParameterKind.CAPACITANCE)
"""The kinds that go by their logarithm."""

Vector = NDArray[np.float64]
BoolArray = NDArray[np.bool_]


class UnitBox:
    """Parameter vectors (P,) as points (D,) of the unit box, and back.

    ``logarithmic`` (P,) marks parameters that go by their logarithm, ``inert`` (P,) those that are not
    searched and keep their values of ``defaults``.
    """

    def __init__(
        self,
        lower: Vector,
        upper: Vector,
        defaults: Vector,
        logarithmic: BoolArray,
        inert: BoolArray | None = None,
    ) -> None:
        searched = np.ones(len(defaults), np.bool_) if inert is None else ~inert
        self.free = np.flatnonzero(searched)
        # An inert parameter has no range: its value is the default, whatever its coordinate.
        self._lower = np.where(searched, lower, defaults)
        self._upper = np.where(searched, upper, defaults)
        self._coordinate = np.maximum(np.cumsum(searched) - 1, 0)
        self._logarithmic = _runs(logarithmic)
        self._first = self._scaled(self._lower)
        self._span = self._scaled(self._upper) - self._first
        start: Vector = (self._scaled(defaults) - self._first)[self.free] / self._span[self.free]
        self.start = start
        """(D,) where the defaults are."""

    @classmethod
    def of(cls, layout: ParameterLayout, defaults: Vector, inert: BoolArray | None = None) -> Self:
        """Return the box of a layout's parameters."""
        logarithmic = np.zeros(layout.size, np.bool_)
        for block in layout.blocks:
            logarithmic[block.slice] = block.kind in FACTORS
        return cls(layout.lower, layout.upper, defaults, logarithmic, inert)

    @property
    def size(self) -> int:
        """D, the number of free parameters."""
        return len(self.free)

    def vectors(self, points: Vector) -> Vector:
        """Return the parameter vectors (n, P) of points (n, D)."""
        values: Vector = points.take(self._coordinate, axis=1)
        values *= self._span
        values += self._first
        for run in self._logarithmic:
            np.exp(values[:, run], out=values[:, run])
        np.maximum(values, self._lower, out=values)
        return np.minimum(values, self._upper, out=values)

    def _scaled(self, values: Vector) -> Vector:
        scaled = values.copy()
        for run in self._logarithmic:
            np.log(scaled[run], out=scaled[run])
        return scaled


def _runs(marked: BoolArray) -> list[slice]:
    """Return where runs of marked entries are: to work on slices is quicker than on a mask."""
    edges = np.flatnonzero(np.diff(marked, prepend=False, append=False)).tolist()
    return [slice(start, end) for start, end in zip(edges[::2], edges[1::2], strict=True)]


def reflected(points: Vector) -> Vector:
    """Return points folded back into the unit box, as if its walls were mirrors."""
    folded = points - 2.0 * np.floor(points / 2.0)
    return np.minimum(folded, 2.0 - folded)
