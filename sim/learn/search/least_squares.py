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
    """Return where damped Gauss-Newton steps from ``point`` (D,) lead: (n, D), in the unit box.

    A step d minimises |W (r + J d)|² + damping |d|² (Levenberg 1944, Marquardt 1963), W being diagonal with
    ``weights`` (R,). Parameters that would leave the box are held first, the others are clipped.

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
    """Return where the steps lead; ``products`` (R, R) is SᵀS."""
    # With less damping than that, rounding could make the matrix negative.
    least = _LEAST_SHARE * np.diag(products).max()
    targets = np.empty((len(dampings), len(point)))
    for n in range(len(dampings)):
        matrix = products.copy()
        for i in range(len(right)):
            matrix[i, i] += max(dampings[n], least)
        lower = np.linalg.cholesky(matrix)
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
        targets[n] = point - rows @ solution
    clipped: Vector = np.minimum(np.maximum(targets, 0.0), 1.0)
    return clipped


@kernel
def correct_slopes(slopes: Vector, step: Vector, change: Vector) -> None:
    """Correct the slopes by the least that makes a step (D,) explain how residuals changed (Broyden 1965).

    ``change`` (r,) is that of the first r residuals, r <= R; the slopes of the others stay.
    """
    length = np.dot(step, step)
    if length == 0.0:
        return
    unexplained = change.copy()
    for d in range(len(step)):
        for i in range(len(change)):
            unexplained[i] -= step[d] * slopes[d, i]
    for d in range(len(step)):
        for i in range(len(change)):
            slopes[d, i] += step[d] / length * unexplained[i]
