"""Delay, acceleration, deceleration and gain of one axis (speed or turn rate) from commands and reports.

The model is the simulator's. A command takes effect after a delay, times a gain, and the motion approaches it
with at most an acceleration, or a deceleration while its size shrinks, so it is piecewise linear in time.
Odometry reports the motion times a scale.
For turns, slip acts on both. The uncertainty of scale and slip adds to that of the fit.

Rules of this file:

1. The record is divided into blocks, one for each change of the command after a pause. A block in which a
   command was lost does not fit the others and is left out as a whole.
2. Reports that show the same number share one rounding error. They count as one sample.
3. Where the residuals are no larger than rounding, the covariance is that of rounding. Otherwise it is the
   cluster-robust one by blocks (CR3, Bell and McCaffrey 2002), which assumes nothing about correlation within
   a block, and no less than that of rounding.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import OptimizeResult, least_squares
from scipy.special import ndtri, stdtrit

from deploy.identify.motion_log import FloatArray, MotionLog

DELAY_MAX_S = 0.8
SCALES = (0.004, 0.01)
"""Residuals of v (m/s) and omega (rad/s) beyond which a sample counts less in the first, robust fit."""
DEFAULT_ACCELERATIONS = (0.31, 1.25)
"""Accelerations of the paper's simulator, m/s² and rad/s²; the search starts from them."""
BOUNDS = (0.05, 20.0)
"""Bounds of the accelerations, as factors of the default ones."""
MIN_MOTION = (0.05, 0.08)
"""An axis whose commands never exceeded this, in m/s and rad/s, is not fitted."""
PAUSE_S = 0.3
"""A command that changes after so long without a change begins a block."""
DIFFERENCES = (0.005, 0.002, 0.01, 0.01)
"""Steps of delay, gain and log accelerations for derivatives; commands of a driver are stairs of 20 ms."""
MIN_BLOCKS, FEW_BLOCKS = 3, 6
"""Fewer than 3 blocks give no variance between blocks; below 6, Student's quantile replaces 1.96."""
SINGULAR = 1e12
"""Condition number beyond which a matrix counts as singular."""
AT_BOUND = 0.003
"""A value this near to its bound is at it."""
NEGLIGIBLE = 1e-3
"""A value is not determined if a unit of it changes all samples by less than this share of SCALES."""
MISFIT = 1.3
"""Limit for residuals that count as rounding: their mean square over that of rounding."""
OUTLIER = 5.0
"""Limit for a block's residual, as a factor of the median block's."""


class OdometryErrors(NamedTuple):
    """Odometry's errors on an axis: scale and slip (s), values (2,) and covariance (2, 2)."""

    values: FloatArray
    covariance: FloatArray


class Axis(NamedTuple):
    """Delay (s), gain as odometry sees it, true acceleration and deceleration (m/s² or rad/s²) of an axis."""

    values: FloatArray
    std: FloatArray
    residual: float
    """Root mean square over the blocks that were kept, m/s or rad/s."""


def identify_axis(log: MotionLog, axis: int, odometry: OdometryErrors) -> Axis | None:
    """Fit axis 0 (v) or 1 (omega); None if its commands were too small, or if nothing fits."""
    if float(np.abs(log.sent[:, axis]).max()) < MIN_MOTION[axis]:
        return None
    times, values = _changes(log.sent_s, log.sent[:, axis])
    t, reported = log.odometry.t, log.motion[:, axis]
    scale, default = SCALES[axis], DEFAULT_ACCELERATIONS[axis]
    weights, groups = _rounding_weights(reported)
    sigma = _step(reported) / math.sqrt(12.0)

    def residuals(x: FloatArray, errors: FloatArray = odometry.values) -> FloatArray:
        motion = _modelled((times + x[0], values), x[1], default * np.exp(x[2:]), errors, t)
        found: FloatArray = motion - reported
        return found

    first = min(
        (
            np.array([delay, 1.0, effort, effort])
            for delay in np.arange(0.0, DELAY_MAX_S, 0.04)
            for effort in (-0.7, 0.0, 1.5)
        ),
        key=lambda x: float(np.log1p(np.square(residuals(x) / scale / 10.0)).sum()),
    )
    least, most = np.log(BOUNDS).tolist()
    bounds = [0.0, 0.3, least, least], [DELAY_MAX_S, 3.0, most, most]
    steps = (0.05, 0.1, 0.2, 0.2)

    def jacobian(x: FloatArray) -> FloatArray:
        return np.column_stack(
            [
                (residuals(x + step) - residuals(x - step)) / (2.0 * step.max())
                for step in np.diag(DIFFERENCES)
            ]
        )

    def robust(basis: FloatArray, start: FloatArray) -> OptimizeResult:
        """Fit the parameters in the subspace ``basis`` (4, k) from a start (k,)."""
        count = len(start)
        return least_squares(
            lambda y: residuals(basis @ y) / scale,
            start,
            lambda y: jacobian(basis @ y) @ basis / scale,
            bounds=(bounds[0][:count], bounds[1][:count]),
            loss="cauchy",
            x_scale=steps[:count],
        )

    # The fit of short ramps has several minima: one of them is near that with one acceleration for both.
    equal_limits = np.eye(4)[:, [0, 1, 2]] + np.eye(4)[:, [3]] * [0.0, 0.0, 1.0]
    starts = first, equal_limits @ robust(equal_limits, first[:3]).x
    x = min((robust(np.eye(4), start) for start in starts), key=lambda fit: float(fit.cost)).x

    begins = times[np.diff(times, prepend=-math.inf) > PAUSE_S]
    blocks = np.searchsorted(begins + x[0], t, side="right")
    kept = ~np.isin(blocks, _outliers(residuals(x), blocks, scale))
    for _ in range(8):
        chosen = kept
        fit = least_squares(
            lambda x, chosen: (residuals(x) * weights)[chosen],
            x,
            lambda x, chosen: (jacobian(x) * weights[:, None])[chosen],
            bounds=bounds,
            x_scale=steps,
            args=(chosen,),
        )
        x = fit.x
        # The solver may stop short of a bound without marking it.
        room = np.minimum(x - bounds[0], bounds[1] - x)[1:]
        if (room < AT_BOUND).any() or DELAY_MAX_S - x[0] < AT_BOUND:
            return None  # the best value is beyond any base's; a delay of 0 at its bound is valid
        kept = ~np.isin(blocks, _outliers(residuals(x), blocks, scale))
        if (kept == chosen).all() or not kept.any():
            break
    # Where commands change more slowly than the base could, they do not show an acceleration: it is left out.
    determined = np.linalg.norm(fit.jac, axis=0) > NEGLIGIBLE * scale
    slopes, covariance = fit.jac[:, determined], np.diag(np.where(determined, 0.0, np.inf))
    covariance[np.ix_(determined, determined)] = _covariance(
        slopes, fit.fun, blocks[chosen], weights[chosen] * sigma, groups[chosen]
    )
    by_odometry = np.column_stack(
        [
            (residuals(x, odometry.values + change) - residuals(x))[chosen] / 1e-4
            for change in 1e-4 * np.eye(2)
        ]
    )
    shift = np.zeros((len(x), 2))
    shift[determined] = np.linalg.lstsq(slopes, by_odometry * weights[chosen][:, None])[0]
    units = np.append(np.ones(2), default * np.exp(x[2:]))
    deviations = units * np.sqrt(np.diag(covariance + shift @ odometry.covariance @ shift.T))
    found = np.append(x[:2], units[2:])
    residual = float(np.sqrt(np.mean(np.square(residuals(x)[chosen]))))
    return Axis(found, deviations, residual)


def _changes(times: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the commands that differ from the one before, which is 0 at first."""
    new = np.diff(values, prepend=0.0) != 0.0
    return times[new], values[new]


def _modelled(
    commands: tuple[FloatArray, FloatArray],
    gain: float,
    limits: FloatArray,
    errors: FloatArray,
    t: FloatArray,
) -> FloatArray:
    """Return the reported motion at ``t`` for commands at the times when they take effect.

    ``limits`` (2,) are acceleration and deceleration.
    """
    (due, asked), (scale, slip), (rise, fall) = commands, errors.tolist(), limits.tolist()
    targets = gain / scale * asked
    targets = targets * (1.0 - slip * np.abs(targets))
    knots, speeds = [-1e9], [0.0]
    now, speed, target = -1e9, 0.0, 0.0
    for when, wanted in zip([*due.tolist(), math.inf], [*targets.tolist(), 0.0], strict=True):
        # Through a change of sign the size first shrinks to 0.
        for goal in (0.0, target) if speed * target < 0.0 else (target,):
            limit = fall if abs(goal) < abs(speed) else rise
            reached = now + abs(goal - speed) / limit
            if reached < when:
                speed = goal
            else:
                reached, speed = when, speed + math.copysign(limit * (when - now), goal - speed)
            knots.append(reached)
            speeds.append(speed)
            now = reached
        if when < math.inf:
            knots.append(when)
            speeds.append(speed)
        now, target = when, wanted
    motion = np.interp(t, knots, speeds)
    found: FloatArray = scale * motion * (1.0 + slip * np.abs(motion))
    return found


def _rounding_weights(reported: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return weights (n,) that make all reports of one size count as one sample, and signed sizes (n,)."""
    sizes = np.round(np.abs(reported), 7)
    _, numbers, counts = np.unique(sizes, return_inverse=True, return_counts=True)
    return 1.0 / np.sqrt(counts[numbers]), np.sign(reported) * sizes


def _step(reported: FloatArray) -> float:
    """Return the step in which a speed is reported: the smallest difference between two reports."""
    gaps = np.diff(np.unique(np.round(np.abs(reported), 7)))
    return float(gaps.min()) if len(gaps) else 0.0


def _outliers(residuals: FloatArray, blocks: NDArray[np.intp], scale: float) -> list[int]:
    """Return the numbers of the blocks that do not fit."""
    numbers = np.unique(blocks)
    sizes = np.array([np.sqrt(np.mean(np.square(residuals[blocks == number]))) for number in numbers])
    moved = sizes[sizes > 0.0]
    limit = max(OUTLIER * float(np.median(moved)) if len(moved) else 0.0, 0.3 * scale)
    found: list[int] = numbers[sizes > limit].tolist()
    return found


def _covariance(
    jacobian: FloatArray,
    residuals: FloatArray,
    blocks: NDArray[np.intp],
    rounding: FloatArray,
    reported: FloatArray,
) -> FloatArray:
    """Return the parameters' covariance: of rounding, and by blocks if the residuals are larger than it.

    ``rounding`` (n,) is its standard deviation in each row, ``reported`` (n,) the reported number, whose
    rounding error has its sign. Infinite if the record does not determine all parameters.
    """
    size = jacobian.shape[1]
    curvature = jacobian.T @ jacobian
    if not np.linalg.cond(curvature) < SINGULAR:
        return np.diag(np.full(size, np.inf))
    bread = np.linalg.inv(curvature)
    rounded = np.zeros((size, size))
    for number in np.unique(np.abs(reported[reported != 0.0])):
        chosen = np.abs(reported) == number
        score = jacobian[chosen].T @ (np.sign(reported) * rounding)[chosen]
        rounded += np.outer(score, score)
    by_rounding: FloatArray = bread @ rounded @ bread
    moving = reported != 0.0
    if np.sum(np.square(residuals[moving])) <= MISFIT * np.sum(np.square(rounding[moving])):
        return by_rounding
    moved = np.unique(blocks[moving])
    if len(moved) < MIN_BLOCKS:
        return np.diag(np.full(size, np.inf))
    clustered = np.zeros((size, size))
    for block in moved:
        rows, block_residuals = jacobian[blocks == block], residuals[blocks == block]
        inside = np.eye(len(rows)) - rows @ bread @ rows.T
        # A parameter that one block alone determines has no variance between blocks.
        if not np.linalg.cond(inside) < SINGULAR:
            return np.diag(np.full(size, np.inf))
        score = rows.T @ np.linalg.solve(inside, block_residuals)
        clustered += np.outer(score, score)
    if len(moved) < FEW_BLOCKS:
        clustered *= (stdtrit(len(moved) - 1, 0.975) / ndtri(0.975)) ** 2
    by_blocks: FloatArray = bread @ clustered @ bread
    np.fill_diagonal(by_blocks, np.maximum(np.diag(by_blocks), np.diag(by_rounding)))
    return by_blocks
