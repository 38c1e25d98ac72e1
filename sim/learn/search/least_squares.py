"""Arithmetic of nonlinear least squares, in a fixed order of operations.

A library's linear algebra gives other last bits on another machine, or with another number of threads, and a
search then takes another path. These kernels do not.

Shapes: R residuals of D parameters; ``slopes`` (D, R) are the derivatives, a row for each parameter.
"""

import math

import numpy as np
from numpy.typing import NDArray

from rover_ncp.circuit.solver import exp2
from rover_ncp.kernels.jit import kernel
from rover_ncp.kernels.vectors import WIDTH, load, store, total

FloatArray = NDArray[np.float64]

LOG2_E = 1.4426950408889634
_LEAST_SHARE = 1e-12
# Below 2**-1000 the exponential means nothing, and nothing is left to gain.
_LEAST_EXPONENT = -1000.0


@kernel
def damped_steps(  # noqa: PLR0917  # as a kernel's caller has them
    slopes: FloatArray,
    residuals: FloatArray,
    weights: FloatArray,
    point: FloatArray,
    dampings: FloatArray,
    targets: FloatArray,
) -> None:
    """Write where damped Gauss-Newton steps from ``point`` (D,) lead: ``targets`` (n, D), in the unit box.

    A step d minimises |W (r + J d)|² + damping |d|² (Levenberg 1944, Marquardt 1963), W being diagonal with
    ``weights`` (R,). Parameters that would leave the box are held first, the others are clipped.

    With S the slopes, weighted, d = -S (SᵀS + damping)⁻¹ W r: R equations, which are fewer than D as long as
    there are fewer residuals than parameters.
    """
    parameters, count = slopes.shape
    # Whole vectors: residuals are padded with some that are 0 and that no parameter moves.
    blocks = (count + WIDTH - 1) // WIDTH
    rows = np.empty((parameters, blocks, WIDTH))
    right = np.zeros((1, blocks, WIDTH))
    flat_rows, flat_right = rows.reshape(parameters, blocks * WIDTH), right.reshape(blocks * WIDTH)
    for i in range(count):
        flat_right[i] = residuals[i] * weights[i]
    for d in range(parameters):
        for i in range(count):
            flat_rows[d, i] = slopes[d, i] * weights[i]
        flat_rows[d, count:] = 0.0
        if point[d] <= 0.0 or point[d] >= 1.0:
            gradient = dot(rows, d, right, 0, 0)
            if (point[d] <= 0.0 and gradient > 0.0) or (point[d] >= 1.0 and gradient < 0.0):
                rows[d] = 0.0
    products = np.empty((blocks * WIDTH, blocks, WIDTH))
    multiply(rows, products)
    upper, solution = np.empty_like(products), np.empty_like(right)
    largest = 0.0
    for i in range(count):
        largest = max(largest, products[i, i // WIDTH, i % WIDTH])
    for n in range(len(dampings)):
        # With less than that, rounding could make the matrix negative.
        factorise(products, max(dampings[n], _LEAST_SHARE * largest), upper)
        solution[:] = right
        solve(upper, solution)
        for d in range(parameters):
            targets[n, d] = min(max(point[d] - dot(rows, d, solution, 0, 0), 0.0), 1.0)


@kernel
def dot(a: FloatArray, row: int, b: FloatArray, other: int, first: int) -> float:
    """Return the product of two rows of blocks, from block ``first`` on."""
    products = load(a, row, first) * load(b, other, first)
    for block in range(first + 1, a.shape[1]):
        products = products + load(a, row, block) * load(b, other, block)
    product: float = total(products)
    return product


@kernel
def multiply(rows: FloatArray, products: FloatArray) -> None:
    """Write SᵀS of S, given as rows of blocks; below the diagonal only what shares its blocks."""
    for i in range(0, len(products), 4):
        place, lane = i // WIDTH, i % WIDTH
        for block in range(place, rows.shape[1]):
            # Four rows at a time, so that a processor need not wait for one sum to add to it again.
            row = load(rows, 0, block)
            a, b = rows[0, place, lane] * row, rows[0, place, lane + 1] * row
            c, d = rows[0, place, lane + 2] * row, rows[0, place, lane + 3] * row
            for n in range(1, len(rows)):
                row = load(rows, n, block)
                a = a + rows[n, place, lane] * row
                b = b + rows[n, place, lane + 1] * row
                c = c + rows[n, place, lane + 2] * row
                d = d + rows[n, place, lane + 3] * row
            store(products, i, block, a)
            store(products, i + 1, block, b)
            store(products, i + 2, block, c)
            store(products, i + 3, block, d)


@kernel
def factorise(matrix: FloatArray, damping: float, upper: FloatArray) -> None:
    """Write Cholesky's U, where UᵀU is a symmetric positive matrix with ``damping`` on its diagonal."""
    count, blocks, _ = matrix.shape
    for i in range(count):
        place, lane = i // WIDTH, i % WIDTH
        upper[i, place:] = matrix[i, place:]
        upper[i, place, lane] += damping
        block = place
        # Three blocks at a time stay in registers while all earlier rows are taken off.
        while block + 3 <= blocks:
            a, b, c = load(upper, i, block), load(upper, i, block + 1), load(upper, i, block + 2)
            for k in range(i):
                factor = upper[k, place, lane]
                a = a - factor * load(upper, k, block)
                b = b - factor * load(upper, k, block + 1)
                c = c - factor * load(upper, k, block + 2)
            store(upper, i, block, a)
            store(upper, i, block + 1, b)
            store(upper, i, block + 2, c)
            block += 3
        while block < blocks:
            a = load(upper, i, block)
            for k in range(i):
                a = a - upper[k, place, lane] * load(upper, k, block)
            store(upper, i, block, a)
            block += 1
        inverse = 1.0 / math.sqrt(upper[i, place, lane])
        for block in range(place, blocks):
            store(upper, i, block, load(upper, i, block) * inverse)


@kernel
def solve(upper: FloatArray, vector: FloatArray) -> None:
    """Replace ``vector`` b by the x of UᵀU x = b."""
    count, blocks, _ = upper.shape
    for i in range(count):
        place, lane = i // WIDTH, i % WIDTH
        found = vector[0, place, lane] / upper[i, place, lane]
        # What is below the diagonal would reach those found before, which share the block.
        upper[i, place, :lane] = 0.0
        for block in range(place, blocks):
            store(vector, 0, block, load(vector, 0, block) - found * load(upper, i, block))
        vector[0, place, lane] = found
    for i in range(count - 1, -1, -1):
        place, lane = i // WIDTH, i % WIDTH
        pivot, known = upper[i, place, lane], vector[0, place, lane]
        vector[0, place, lane] = 0.0
        vector[0, place, lane] = (known - dot(upper, i, vector, 0, place)) / pivot


@kernel
def measure_slope(
    slopes: FloatArray, origin: FloatArray, there: FloatArray, point: FloatArray, misses: FloatArray
) -> None:
    """Write the slopes of the one parameter in which ``point`` (D,) differs from ``origin``, from the misses
    (E, C, 3) at both: ``there`` those at the origin."""
    parameter, most = 0, 0.0
    for d in range(len(point)):
        if abs(point[d] - origin[d]) > most:
            parameter, most = d, abs(point[d] - origin[d])
    moved = point[parameter] - origin[parameter]
    measured, before = misses.reshape(misses.size), there.reshape(there.size)
    for i in range(len(measured)):
        slopes[parameter, i] = (measured[i] - before[i]) / moved


@kernel
def correct_slopes(  # noqa: PLR0917  # as above
    slopes: FloatArray,
    origin: FloatArray,
    there: FloatArray,
    point: FloatArray,
    misses: FloatArray,
    known: int,
) -> None:
    """Correct the slopes by the least that makes the step from ``origin`` (D,) to ``point`` explain how the
    misses (E, C, 3) of the first ``known`` checkpoints changed (Broyden 1965): ``there`` those at the origin.

    With some of the checkpoints, E must be 1.
    """
    step = point - origin
    length = 0.0
    for d in range(len(step)):
        length += step[d] * step[d]
    if length == 0.0:
        return
    episodes, _, axes = misses.shape
    count = episodes * known * axes
    unexplained = (misses.reshape(misses.size) - there.reshape(there.size))[:count]
    for d in range(len(step)):
        for i in range(count):
            unexplained[i] -= step[d] * slopes[d, i]
    for d in range(len(step)):
        factor = step[d] / length
        for i in range(count):
            slopes[d, i] += factor * unexplained[i]


@kernel
def lost_at(misses: FloatArray, to_beat: float) -> tuple[int, float]:
    """Return how many checkpoints it takes until the return of ``misses`` (1, C, 3) is below ``to_beat``, and
    what it is there; C, and minus infinity, if it never is."""
    total = 0.0
    if to_beat > -np.inf:
        for checkpoint in range(misses.shape[1]):
            dx, dy, dtheta = misses[0, checkpoint, 0], misses[0, checkpoint, 1], misses[0, checkpoint, 2]
            total -= dx * dx + dy * dy + dtheta * dtheta
            if total < to_beat:
                return checkpoint + 1, total
    return misses.shape[1], -np.inf


@kernel
def survival(misses: FloatArray, lifetime: float) -> float:
    """Return how far along an episode of ``misses`` (E, C, 3) stays on course: C if it never misses.

    The mean over E episodes of the sum over checkpoints of exp(-L / lifetime), L being the loss up to that
    checkpoint."""
    reached = 0.0
    for episode in range(misses.shape[0]):
        loss = 0.0
        for checkpoint in range(misses.shape[1]):
            for axis in range(misses.shape[2]):
                loss += misses[episode, checkpoint, axis] ** 2
            reached += exp2(max(-loss / lifetime * LOG2_E, _LEAST_EXPONENT))
    mean: float = reached / misses.shape[0]
    return mean


@kernel
def survival_weights(misses: FloatArray, lifetime: float, weights: FloatArray) -> None:
    """Write the weights (E, C, 3) under which least squares climb ``survival``; their mean square is 1.

    A squared miss at checkpoint c lowers the terms of c and of all later ones: the weight of the squares is
    the sum of these terms, that of the misses its root.
    """
    episodes, checkpoints, axes = misses.shape
    sum_of_weights = 0.0
    for episode in range(episodes):
        loss = 0.0
        for checkpoint in range(checkpoints):
            for axis in range(axes):
                loss += misses[episode, checkpoint, axis] ** 2
            weights[episode, checkpoint, 0] = exp2(max(-loss / lifetime * LOG2_E, _LEAST_EXPONENT))
        later = 0.0
        for checkpoint in range(checkpoints - 1, -1, -1):
            later += weights[episode, checkpoint, 0]
            sum_of_weights += later
            weights[episode, checkpoint, :] = later
    scale = episodes * checkpoints / sum_of_weights
    for episode in range(episodes):
        for checkpoint in range(checkpoints):
            for axis in range(axes):
                weights[episode, checkpoint, axis] = math.sqrt(weights[episode, checkpoint, axis] * scale)
