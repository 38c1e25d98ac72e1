"""Nonlinear least squares: damped Gauss-Newton steps and Broyden's correction of the slopes.

Mostly compiled, with LAPACK's Cholesky factorisation: between two calls the evaluator displaces all code and
data from the processor's caches, after which numpy's many small operations take two to four times as long.

Shapes: R residuals of D parameters; ``slopes`` (D, R) are the derivatives, a row for each parameter.
"""

import numpy as np

from rover_ncp.kernels.jit import kernel
from sim.learn.search.base import Vector

_LEAST_SHARE = 1e-12


def damped_steps(
    slopes: Vector, residuals: Vector, weights: Vector, point: Vector, dampings: Vector
) -> Vector:
    """Return where n damped Gauss-Newton steps from ``point`` (D,) lead, and the point: (n + 1, D).

    A step d minimises |W (r + J d)|² + damping |d|² (Levenberg 1944, Marquardt 1963), W being diagonal with
    ``weights`` (R,). Parameters that would leave the unit box are held first, the others are clipped.

    With S the weighted slopes, d = -S (SᵀS + damping)⁻¹ W r. These are R equations, often fewer than D.
    """
    rows, right = _weighted(slopes, residuals, weights, point)
    # By numpy: it computes half of a product with the transpose (BLAS's syrk), numba in a kernel all of it.
    targets: Vector = _solved(rows, right, rows.T @ rows, point, dampings)
    return targets


@kernel
def _weighted(slopes: Vector, residuals: Vector, weights: Vector, point: Vector) -> tuple[Vector, Vector]:
    """Return the weighted slopes, those of held parameters 0, and the weighted residuals."""
    rows, right = slopes * weights, residuals * weights
    gradient = rows @ right
    for d in range(len(point)):
        if (point[d] <= 0.0 and gradient[d] > 0.0) or (point[d] >= 1.0 and gradient[d] < 0.0):
            rows[d] = 0.0
    return rows, right


@kernel
def _solved(rows: Vector, right: Vector, products: Vector, point: Vector, dampings: Vector) -> Vector:
    """Return where the steps lead, and the point; ``products`` (R, R) is SᵀS and is overwritten."""
    # With less damping than that, rounding could make the matrix negative.
    diagonal = np.diag(products).copy()
    least = _LEAST_SHARE * diagonal.max()
    targets = np.empty((len(dampings) + 1, len(point)))
    targets[-1] = point
    for n in range(len(dampings)):
        for i in range(len(right)):
            products[i, i] = diagonal[i] + max(dampings[n], least)
        lower = np.linalg.cholesky(products.T)  # the same matrix, in the order in which LAPACK wants it
        upper = np.ascontiguousarray(lower.T)
        solution = right.copy()
        # Column by column: such loops are vectorised, those over rows are sums, whose order must not change.
        for i in range(len(right)):
            solution[i] /= lower[i, i]
            for j in range(i + 1, len(right)):
                solution[j] -= solution[i] * upper[i, j]
        for i in range(len(right) - 1, -1, -1):
            solution[i] /= lower[i, i]
            for j in range(i):
                solution[j] -= solution[i] * lower[i, j]
        step = rows @ solution
        for d in range(len(point)):
            targets[n, d] = min(max(point[d] - step[d], 0.0), 1.0)
    return targets


@kernel
def measure_slopes(slopes: Vector, point: Vector, misses: Vector, there: Vector, found: Vector) -> None:
    """Set the slopes of the one parameter in which ``there`` (D,) differs from ``point`` (D,).

    ``misses`` and ``found`` hold the R residuals at these points.
    """
    parameter = np.abs(there - point).argmax()
    slopes[parameter] = (found - misses).ravel() / (there[parameter] - point[parameter])


@kernel
def correct_slopes(slopes: Vector, point: Vector, misses: Vector, there: Vector, found: Vector) -> None:
    """Correct the slopes by the least that makes a step explain how residuals changed (Broyden 1965).

    The step leads from ``point`` to ``there``, (D,) each; ``misses`` hold the R residuals at the one and
    ``found`` the first r of those at the other. The slopes of the others stay.
    """
    step = there - point
    length = np.dot(step, step)
    if length == 0.0:
        return
    unexplained = (found - misses[: len(found)]).ravel()
    for d in range(len(step)):
        for i in range(len(unexplained)):
            unexplained[i] -= step[d] * slopes[d, i]
    for d in range(len(step)):
        for i in range(len(unexplained)):
            slopes[d, i] += step[d] / length * unexplained[i]
