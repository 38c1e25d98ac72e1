"""Nonlinear least squares: damped Gauss-Newton steps and Broyden's correction of the slopes.

Compiled, with scipy's BLAS and LAPACK: between two calls the evaluator displaces all code and data from the
processor's caches, after which numpy's many small operations take two to four times as long.

Shapes: R residuals of D parameters; ``slopes`` (D, R) are the derivatives, a row for each parameter.
"""

import numpy as np
from numba.extending import get_cython_function_address

from rover_ncp.kernels.jit import call_fortran, kernel
from sim.learn.search.unit_box import Vector

_MIN_SHARE = 1e-12


def damped_steps(
    slopes: Vector, residuals: Vector, weights: Vector, point: Vector, dampings: Vector
) -> Vector:
    """Return where n damped Gauss-Newton steps from ``point`` (D,) lead, and the point: (n + 1, D).

    A step d minimises |W (r + J d)|² + damping |d|² (Levenberg 1944, Marquardt 1963), W being diagonal with
    ``weights`` (R,). Parameters that would leave the unit box are held first, the others are clipped.

    With S the weighted slopes, d = -S (SᵀS + damping)⁻¹ W r. These are R equations, often fewer than D.
    """
    targets: Vector = _damped_steps(_SYRK, _POTRF, slopes, residuals, weights, point, dampings)
    return targets


# Addresses of routines of scipy's BLAS and LAPACK, for kernels. numba by itself multiplies matrices without
# use of symmetry, and copies a matrix before it factorises it.
_SYRK = get_cython_function_address("scipy.linalg.cython_blas", "dsyrk")
_POTRF = get_cython_function_address("scipy.linalg.cython_lapack", "dpotrf")
# Fortran's matrices are the transposes of ours: our upper triangle is its lower one.
_OUR_LOWER, _OUR_UPPER, _AS_IT_IS = ord("U"), ord("L"), ord("N")


@kernel
def _damped_steps(  # noqa: PLR0917  # those of damped_steps, and the routines' addresses, which change
    syrk: int,
    potrf: int,
    slopes: Vector,
    residuals: Vector,
    weights: Vector,
    point: Vector,
    dampings: Vector,
) -> Vector:
    rows, right = _weighted(slopes, residuals, weights, point)
    size, count = rows.shape
    products, lower, failed = np.empty((count, count)), np.empty((count, count)), np.zeros(1, np.int32)
    # The upper triangle, as numpy has it computed: of the lower one the last bits may be others.
    call_fortran(syrk, (_OUR_UPPER, _AS_IT_IS, count, size, 1.0, rows, count, 0.0, products, count))
    largest = 0.0
    for i in range(count):
        if not np.isfinite(products[i, i]):  # LAPACK would not always object
            raise np.linalg.LinAlgError("the slopes are not finite")
        largest = max(largest, products[i, i])
        for j in range(i):
            products[i, j] = products[j, i]
    # With less damping than that, rounding could make the matrix negative.
    least = _MIN_SHARE * largest
    targets = np.empty((len(dampings) + 1, size))
    targets[-1] = point
    for n in range(len(dampings)):
        for i in range(count):
            for j in range(i):
                lower[i, j] = products[i, j]
            lower[i, i] = products[i, i] + max(dampings[n], least)
        call_fortran(potrf, (_OUR_LOWER, count, lower, count, failed))
        if failed[0] != 0:
            raise np.linalg.LinAlgError("the damped matrix is not positive definite")
        step = rows @ _solution(lower, right)
        for d in range(size):
            targets[n, d] = min(max(point[d] - step[d], 0.0), 1.0)
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
def _solution(lower: Vector, right: Vector) -> Vector:
    """Return the solution (R,) of L Lᵀ x = ``right``, L (R, R) being the lower triangle of ``lower``."""
    solution = right.copy()
    for i in range(len(right)):
        for j in range(i):
            solution[i] -= lower[i, j] * solution[j]
        solution[i] /= lower[i, i]
    for i in range(len(right) - 1, -1, -1):
        solution[i] /= lower[i, i]
        for j in range(i):
            solution[j] -= solution[i] * lower[i, j]
    return solution


@kernel
def measure_slopes(slopes: Vector, point: Vector, residuals: Vector, there: Vector, found: Vector) -> None:
    """Set the slopes of the one parameter in which ``there`` (D,) differs from ``point`` (D,).

    ``residuals`` and ``found`` hold the R residuals at these points.
    """
    parameter = np.abs(there - point).argmax()
    slopes[parameter] = (found - residuals).ravel() / (there[parameter] - point[parameter])


@kernel
def correct_slopes(slopes: Vector, point: Vector, residuals: Vector, there: Vector, found: Vector) -> None:
    """Correct the slopes by the least that makes a step explain how residuals changed (Broyden 1965).

    The step leads from ``point`` to ``there``, (D,) each; ``residuals`` hold the R residuals at the one and
    ``found`` the first r of those at the other. The slopes of the others stay.
    """
    step = there - point
    length = np.dot(step, step)
    if length == 0.0:
        return
    unexplained = (found - residuals[: len(found)]).ravel()
    for d in range(len(step)):
        for i in range(len(unexplained)):
            unexplained[i] -= step[d] * slopes[d, i]
    for d in range(len(step)):
        for i in range(len(unexplained)):
            slopes[d, i] += step[d] / length * unexplained[i]
