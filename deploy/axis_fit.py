"""Delay, acceleration and gain of one axis (speed or turn rate) from commands and reported motion.

The model is the simulator's. A command takes effect after a delay, times a gain, and the motion approaches it
with at most one acceleration, so that it is piecewise linear in time. Odometry reports the motion times a
scale; for turns, unseen slip acts on both (`sim.world.randomization`). Scale and slip are given with their
uncertainty, which is carried over into that of the fit.

Rules of this file:

1. The record is divided into blocks, one for each change of the command after a pause. A block in which a
   command was lost does not fit the others and is left out as a whole.
2. Reports that show the same number share one rounding error. They count as one sample.
3. The covariance is the cluster-robust one, by blocks (CR3, Bell and McCaffrey 2002): nothing is assumed about
   correlation within a block. It is never less than rounding alone causes, and just that where the residuals
   are no larger than rounding.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from deploy.motion_log import MotionLog

__all__ = ["Axis", "OdometryPrior", "identify_axis"]

FloatArray = NDArray[np.float64]

DELAY_MAX_S = 0.8
SCALES = (0.004, 0.01)
"""Residuals of v (m/s) and omega (rad/s) beyond which a sample counts less in the first, robust fit."""
USUAL = (0.31, 1.25)
"""Accelerations of the paper's simulator, m/s² and rad/s²."""
BOUNDS = (0.05, 20.0)
"""Of the accelerations, as factors on the usual ones."""
LEAST_MOTION = (0.05, 0.08)
"""An axis that was never asked for more than this, in m/s and rad/s, is not fitted."""
PAUSE_S = 0.3
"""A command that changes after so long without a change begins a block."""
UNFELT = 1e-6
"""A parameter whose largest effect is such a share of another's has none."""
BLOCK_S = 4.0
"""A block lasts no longer: a driver that changes its command all the time would make a single one."""
SINGULAR = 1e12
"""Condition number beyond which a matrix counts as singular."""
MISFIT = 1.3
"""Residuals whose mean square is no more than so many times that of rounding are rounding."""
OUTLIER = 5.0
"""A block is left out if its residual is so many times the median block's, and beyond the robust scale."""


class OdometryPrior(NamedTuple):
    """Odometry's errors on an axis: scale and slip (s), values (2,) and covariance (2, 2)."""

    values: FloatArray
    covariance: FloatArray


class Axis(NamedTuple):
    """One axis: s, m/s² or rad/s² (true), gain as odometry sees it; their standard deviations; SI."""

    delay_s: float
    acceleration: float
    gain: float
    delay_std: float
    acceleration_std: float
    gain_std: float
    residual: float
    """Root mean square over the blocks that were kept, m/s or rad/s."""


def identify_axis(log: MotionLog, axis: int, prior: OdometryPrior) -> Axis | None:
    """Fit axis 0 (v) or 1 (omega); None if it was hardly asked for anything, or nothing fits."""
    if float(np.abs(log.sent[:, axis]).max()) < LEAST_MOTION[axis]:
        return None
    times, values = _changes(log.sent_s, log.sent[:, axis])
    t, reported = log.odometry.t, log.motion[:, axis]
    scale, usual = SCALES[axis], USUAL[axis]
    weights, groups = _rounding_weights(reported)
    sigma = _step(reported) / math.sqrt(12.0)

    def misses(x: FloatArray, odometry: FloatArray = prior.values) -> FloatArray:
        motion = _modelled(times + x[0], values, x[1], usual * math.exp(x[2]), odometry, t)
        found: FloatArray = motion - reported
        return found

    first = min(
        (
            np.array([delay, 1.0, effort])
            for delay in np.arange(0.0, DELAY_MAX_S, 0.04)
            for effort in (-0.7, 0.0, 1.5)
        ),
        key=lambda x: float(np.log1p(np.square(misses(x) / scale / 10.0)).sum()),
    )
    bounds = [0.0, 0.3, math.log(BOUNDS[0])], [DELAY_MAX_S, 3.0, math.log(BOUNDS[1])]
    steps = (0.05, 0.1, 0.2)
    x = least_squares(lambda x: misses(x) / scale, first, bounds=bounds, loss="cauchy", x_scale=steps).x

    begins = times[np.diff(times, prepend=-math.inf) > PAUSE_S]
    blocks = _blocks(begins + x[0], t)
    kept = ~np.isin(blocks, _outliers(misses(x), blocks, scale))
    for _ in range(8):
        chosen = kept

        def residuals(x: FloatArray, chosen: NDArray[np.bool_] = chosen) -> FloatArray:
            found: FloatArray = (misses(x) * weights)[chosen]
            return found

        fit = least_squares(residuals, x, bounds=bounds, x_scale=steps, diff_step=1e-5)
        x = fit.x
        kept = ~np.isin(blocks, _outliers(misses(x), blocks, scale))
        if (kept == chosen).all() or not kept.any():
            break
    # An acceleration that no command asked for has no effect: the others are determined without it.
    free = np.abs(fit.jac).max(axis=0) > UNFELT * np.abs(fit.jac).max()
    jacobian = fit.jac[:, free]
    covariance = _covariance(jacobian, fit.fun, blocks[chosen], weights[chosen] * sigma, groups[chosen])
    by_odometry = np.column_stack(
        [(misses(x, prior.values + change) - misses(x))[chosen] / 1e-4 for change in 1e-4 * np.eye(2)]
    )
    shift = np.linalg.lstsq(jacobian, by_odometry * weights[chosen][:, None])[0]
    deviations = np.full(3, np.inf)
    deviations[free] = np.sqrt(np.diag(covariance + shift @ prior.covariance @ shift.T))
    acceleration = usual * math.exp(x[2])
    return Axis(
        float(x[0]),
        acceleration,
        float(x[1]),
        float(deviations[0]),
        float(deviations[2]) * acceleration,
        float(deviations[1]),
        float(np.sqrt(np.mean(np.square(misses(x)[chosen])))),
    )


def _blocks(begins: FloatArray, t: FloatArray) -> NDArray[np.intp]:
    """Return the block of each sample: a new one at each of ``begins``, and after `BLOCK_S` at the latest."""
    place = np.searchsorted(begins, t, side="right")
    since = t - np.concatenate([[t[0]], begins])[place]
    _, numbers = np.unique(np.column_stack([place, since // BLOCK_S]), axis=0, return_inverse=True)
    found: NDArray[np.intp] = numbers.ravel()
    return found


def _changes(times: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the commands that differ from the one before, which is 0 at first."""
    new = np.diff(values, prepend=0.0) != 0.0
    return times[new], values[new]


def _modelled(
    due: FloatArray, asked: FloatArray, gain: float, acceleration: float, odometry: FloatArray, t: FloatArray
) -> FloatArray:
    """Return the reported motion at ``t``; commands ``asked`` take effect at ``due``."""
    scale, slip = odometry.tolist()
    targets = gain / scale * asked
    targets = targets * (1.0 - slip * np.abs(targets))
    knots, speeds = [-math.inf], [0.0]
    now, speed, target = -1e9, 0.0, 0.0
    for when, wanted in zip([*due.tolist(), math.inf], [*targets.tolist(), 0.0], strict=True):
        reached = now + abs(target - speed) / acceleration
        if reached < when:
            knots.append(reached)
            speeds.append(target)
            speed = target
        else:
            speed += math.copysign(acceleration * (when - now), target - speed)
        if when < math.inf:
            knots.append(when)
            speeds.append(speed)
        now, target = when, wanted
    motion = np.interp(t, knots[1:], speeds[1:])
    found: FloatArray = scale * motion * (1.0 + slip * np.abs(motion))
    return found


def _rounding_weights(reported: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return weights (n,) under which all reports of one size count as one sample, and signed sizes (n,)."""
    sizes = np.round(np.abs(reported), 7)
    _, numbers, counts = np.unique(sizes, return_inverse=True, return_counts=True)
    return 1.0 / np.sqrt(counts[numbers]), np.sign(reported) * sizes


def _step(reported: FloatArray) -> float:
    """Return the step in which a speed is reported: the smallest difference between two reports."""
    gaps = np.diff(np.unique(np.round(np.abs(reported), 7)))
    return float(gaps.min()) if len(gaps) else 0.0


def _outliers(misses: FloatArray, blocks: NDArray[np.intp], scale: float) -> list[int]:
    """Return the blocks that do not fit."""
    numbers = np.unique(blocks)
    sizes = np.array([np.sqrt(np.mean(np.square(misses[blocks == number]))) for number in numbers])
    moved = sizes[sizes > 0.0]
    limit = max(OUTLIER * float(np.median(moved)) if len(moved) else 0.0, 0.3 * scale)
    found: list[int] = numbers[sizes > limit].tolist()
    return found


def _covariance(
    jacobian: FloatArray, residuals: FloatArray, blocks: NDArray[np.intp], rounding: FloatArray, shown: FloatArray
) -> FloatArray:
    """Return the parameters' covariance: of rounding, and by blocks if the residuals are larger than it.

    ``rounding`` (n,) is its standard deviation in each row, ``shown`` (n,) the reported number, whose rounding
    error has its sign. Infinite if the record does not determine all parameters.
    """
    size = jacobian.shape[1]
    curvature = jacobian.T @ jacobian
    if np.linalg.cond(curvature) > SINGULAR:
        return np.diag(np.full(size, np.inf))
    bread = np.linalg.inv(curvature)
    rounded = np.zeros((size, size))
    for number in np.unique(np.abs(shown[shown != 0.0])):
        chosen = np.abs(shown) == number
        pull = jacobian[chosen].T @ (np.sign(shown) * rounding)[chosen]
        rounded += np.outer(pull, pull)
    by_rounding: FloatArray = bread @ rounded @ bread
    moving = shown != 0.0
    if np.sum(np.square(residuals[moving])) <= MISFIT * np.sum(np.square(rounding[moving])):
        return by_rounding
    seen = np.zeros((size, size))
    for block in np.unique(blocks):
        rows, misses = jacobian[blocks == block], residuals[blocks == block]
        inside = np.eye(len(rows)) - rows @ bread @ rows.T
        # A parameter that one block alone determines has no spread between blocks.
        if np.linalg.cond(inside) > SINGULAR:
            return np.diag(np.full(size, np.inf))
        pull = rows.T @ np.linalg.solve(inside, misses)
        seen += np.outer(pull, pull)
    by_blocks: FloatArray = bread @ seen @ bread
    np.fill_diagonal(by_blocks, np.maximum(np.diag(by_blocks), np.diag(by_rounding)))
    return by_blocks
