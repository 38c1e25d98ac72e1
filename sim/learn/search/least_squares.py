"""Nonlinear least squares: damped Gauss-Newton steps and Broyden's correction of the slopes.

Shapes: R residuals of D parameters, three residuals for each of C checkpoints; ``slopes`` (D, R) are the
derivatives, a row for each parameter. The native library computes what is called for each batch.
"""

from functools import cache

import numpy as np

from rover_ncp.native.core import call, linear_algebra
from sim.learn.search.unit_box import Vector

_FAILURES = ("", "the slopes are not finite", "the damped matrix is not positive definite")


def damped_steps(
    slopes: Vector, residuals: Vector, weights: Vector, point: Vector, dampings: Vector
) -> Vector:
    """Return where n damped Gauss-Newton steps from ``point`` (D,) lead, and the point: (n + 1, D).

    A step d minimises |W (r + J d)|² + damping |d|² (Levenberg 1944, Marquardt 1963), W being diagonal with
    ``weights`` (R,). Parameters that would leave the unit box are held first, the others are clipped.

    With S the weighted slopes, d = -S (SᵀS + damping)⁻¹ W r. These are R equations, often fewer than D.
    Raises LinAlgError where there is no solution.
    """
    size, count = slopes.shape
    targets, (step, work) = np.empty((len(dampings) + 1, size)), _scratch(size, count)
    failure = call(
        "rover_ncp_damped_steps",
        *(linear_algebra(), size, count, len(dampings)),
        (slopes, (size, count)),
        (residuals, (count,)),
        (weights, (count,)),
        (point, (size,)),
        (dampings, (len(dampings),)),
        (targets, targets.shape),
        (step, (size,)),
        (work, (size + 2 * count + 2, count)),
    )
    if failure:
        raise np.linalg.LinAlgError(_FAILURES[failure])
    return targets


@cache
def _scratch(size: int, count: int) -> tuple[Vector, Vector]:
    """Return arrays for one thread that need not be allocated at each step."""
    return np.empty(size), np.empty((size + 2 * count + 2, count))


def measure_slopes(slopes: Vector, point: Vector, residuals: Vector, there: Vector, found: Vector) -> None:
    """Set the slopes of the one parameter in which ``there`` (D,) differs from ``point`` (D,).

    ``residuals`` and ``found`` hold the R residuals at these points.
    """
    parameter = np.abs(there - point).argmax()
    slopes[parameter] = (found - residuals).ravel() / (there[parameter] - point[parameter])


def correct_slopes(slopes: Vector, point: Vector, residuals: Vector, there: Vector, found: Vector) -> None:
    """Correct the slopes by the least that makes a step explain how residuals changed (Broyden 1965).

    The step leads from ``point`` to ``there``, (D,) each; ``residuals`` hold the R residuals at the one and
    ``found`` the first r of those at the other. The slopes of the others stay.
    """
    size, count = slopes.shape
    known, (step, work) = found.size, _scratch(size, count)
    call(
        "rover_ncp_correct_slopes",
        *(linear_algebra(), size, count, known),
        (slopes, (size, count)),
        (point, (size,)),
        (residuals.ravel(), (count,)),
        (there, (size,)),
        (found.ravel()[:count], (known,)),
        (step, (size,)),
        (work[0], (count,)),
    )
