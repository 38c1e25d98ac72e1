"""Nonlinear least squares: damped Gauss-Newton steps and Broyden's correction of the slopes.

Shapes: R residuals of D parameters, three residuals for each of C checkpoints. The native library computes
what is called for each batch. Arrays are checked once, where they are made; later calls pass addresses.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import repeat
from typing import Annotated, NamedTuple

import numpy as np

from rover_ncp.native.core import Axes, FloatArray, bound_least_squares, linear_algebra, row_addresses
from sim.learn.search.unit_box import Vector

_FAILURES = ("", "the slopes are not finite", "the damped matrix is not positive definite")


@dataclass(slots=True)
class ScoredPoint:
    """A point (D,) of the unit box, its return, and its residuals (C, 3). ``scored`` makes them."""

    point: Vector
    value: float
    residuals: Vector
    addresses: tuple[int, int]
    """Of point and residuals."""
    shape: tuple[int, int]
    """(D, C)."""


def scored(points: Vector, values: Sequence[float], residuals: Vector) -> list[ScoredPoint]:
    """Return points (n, D) with their returns (n,) and residuals (n, C, 3). The arrays must not change.

    Raises ValueError for arrays of another shape or type, TypeError for one with gaps between its numbers.
    """
    size, checkpoints = points.shape[1], residuals.shape[1]
    addresses = zip(
        row_addresses(points, len(values), size),
        row_addresses(residuals, len(values), checkpoints, 3),
        strict=True,
    )
    return list(map(ScoredPoint, points, values, residuals, addresses, repeat((size, checkpoints))))


class _Arrays(NamedTuple):
    """What the native library works on."""

    routines: tuple[int, ...]
    slopes: Annotated[FloatArray, Axes("parameters", "residuals")]
    factors: Annotated[FloatArray, Axes("steps")]
    targets: Annotated[FloatArray, Axes("steps+1", "parameters")]
    weights: Annotated[FloatArray, Axes("residuals")]
    step: Annotated[FloatArray, Axes("parameters")]
    weighted: Annotated[FloatArray, Axes("parameters", "residuals")]
    products: Annotated[FloatArray, Axes("residuals", "residuals")]
    lower: Annotated[FloatArray, Axes("residuals", "residuals")]
    right: Annotated[FloatArray, Axes("residuals")]
    solution: Annotated[FloatArray, Axes("residuals")]


class LeastSquares:
    """``slopes`` (D, R), a row for each parameter, are the derivatives of the residuals; 0 at first.

    ``factors`` (S,) multiply the damping, one for each step of a batch. ``weights`` (R,) are those of the
    residuals in the last steps.
    """

    def __init__(self, size: int, checkpoints: int, factors: Sequence[float]) -> None:
        count = 3 * checkpoints
        self._shape, self._most = (size, checkpoints), len(factors)
        self.slopes, self.weights = np.zeros((size, count)), np.ones(count)
        self._targets = np.empty((len(factors) + 1, size))
        arrays = _Arrays(
            routines=linear_algebra(),
            slopes=self.slopes,
            factors=np.array(factors, np.float64),
            targets=self._targets,
            weights=self.weights,
            step=np.empty(size),
            weighted=np.empty((size, count)),
            products=np.empty((count, count)),
            lower=np.empty((count, count)),
            right=np.empty(count),
            solution=np.empty(count),
        )
        self._find_steps, self._measure, self._correct, self._survival = bound_least_squares(arrays)

    def steps(self, at: ScoredPoint, damping: float, count: int, lifetime: float = 0.0) -> Vector:
        """Return where the first n damped Gauss-Newton steps from a point lead, and the point: (n + 1, D).

        A step d minimises |W (r + J d)|² + damping |d|² (Levenberg 1944, Marquardt 1963). W is diagonal. It
        is 1 without a lifetime, otherwise such that the step climbs ``survival``: a squared residual lowers
        the terms of its checkpoint and of all later ones. The weight of the squares is the sum of these
        terms, scaled to a mean of 1, that of the residuals its root. Parameters that would leave the unit box
        are held first, the others are clipped.

        With S the weighted slopes, d = -S (SᵀS + damping)⁻¹ W r. These are R equations, often fewer than D.
        Raises LinAlgError where there is no solution.
        """
        if not 0 < count <= self._most:
            raise ValueError(f"{count} steps, expected 1 to {self._most}")
        failure = self._find_steps(count, damping, lifetime, *self._addresses(at))
        if failure:
            raise np.linalg.LinAlgError(_FAILURES[failure])
        return self._targets[: count + 1].copy()

    def measure(self, at: ScoredPoint, probe: ScoredPoint) -> None:
        """Set the slopes of the one parameter in which a probe differs from a point."""
        self._measure(*self._addresses(at), *self._addresses(probe))

    def correct(self, at: ScoredPoint, there: ScoredPoint, to_beat: float) -> None:
        """Correct the slopes by the least that makes a step explain how residuals changed (Broyden 1965).

        The step leads from ``at`` to ``there``, whose episode may have been truncated where its return fell
        below ``to_beat``: the residuals behind that checkpoint are not looked at, and their slopes stay.
        """
        self._correct(to_beat, *self._addresses(at), *self._addresses(there))

    def survival(self, outcome: ScoredPoint, lifetime: float) -> float:
        """Return how far along its episode an outcome stays on course: C if there is no error.

        The sum over checkpoints of exp(-L / lifetime), L being the loss up to that checkpoint.
        """
        survived: float = self._survival(lifetime, self._addresses(outcome)[1])
        return survived

    def _addresses(self, outcome: ScoredPoint) -> tuple[int, int]:
        if outcome.shape != self._shape:
            raise ValueError(f"an outcome of (parameters, checkpoints) {outcome.shape}, not {self._shape}")
        return outcome.addresses
