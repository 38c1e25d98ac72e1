"""Delay, gain, acceleration and deceleration of one axis (speed or turn rate) from commands and reports.

The model is the simulator's. A command takes effect after a delay, times a gain, and the motion approaches it
with at most an acceleration, or a deceleration while its size shrinks. Odometry reports the motion times a
scale, and for turns with slip.

Each step from rest to rest is fitted by itself. A step that fits much worse than others lost a command and is
left out. The value of the axis is the median over its steps, and its standard deviation is that of such a
median, by the scatter of the steps. So nothing is assumed about the noise within a step.
"""

import math
from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares

from deploy.identify.motion_log import FloatArray, MotionLog
from deploy.identify.odometry_fit import Fit, student

DELAY_MAX_S = 0.8
SCALES = (0.004, 0.01)
"""Residuals of v (m/s) and omega (rad/s) beyond which a report counts less."""
DEFAULT_ACCELERATIONS = (0.31, 1.25)
"""Accelerations of the paper's simulator, m/s² and rad/s²; the search starts from them."""
BOUNDS = (0.05, 20.0)
"""Bounds of the accelerations, as factors of the default ones."""
MIN_MOTION = (0.05, 0.08)
"""A step whose commands never exceed this, in m/s and rad/s, is not fitted."""
PAUSE_S = 0.3
"""A command of 0 that lasts so long ends a step."""
AFTER_S = 1.5
"""Reports of a step end so long after its last command."""
DIFFERENCES = (0.005, 0.002, 0.01, 0.01)
"""Steps of delay, gain and log accelerations for derivatives; commands of a driver are stairs of 20 ms."""
MIN_STEPS = 3
"""Steps that must determine a value."""
OUTLIER, MISFIT = 5.0, 0.3
"""Limit for the residual of a step, as factors of that of the best quarter, and of SCALES if that is more."""
AT_BOUND = 0.003
"""A value this near to its bound is at it."""
NEGLIGIBLE = 0.02
"""A step determines a value if a unit of it changes a report by at least this share of SCALES."""
CHANGE = 1e-3
"""Change of a scale, and of a slip in s, for derivatives."""


class Axis(NamedTuple):
    """Delay (s), gain as odometry sees it, true acceleration and deceleration (m/s² or rad/s²) of an axis."""

    values: FloatArray
    std: FloatArray
    """Infinite for a value that too few steps determine."""
    residual: float
    """Root mean square of the median step, m/s or rad/s."""


class _Step(NamedTuple):
    """Commands with their times from rest to rest, and the reports with theirs."""

    times: FloatArray
    commands: FloatArray
    t: FloatArray
    reported: FloatArray


class _StepFit(NamedTuple):
    """Delay, gain and the logarithms of both accelerations; NaN for one that the step does not determine."""

    values: FloatArray
    residual: float


def identify_axis(log: MotionLog, axis: int, odometry: Fit) -> Axis | None:
    """Fit axis 0 (v) or 1 (omega) with odometry's scale and slip (s) on it.

    Return None if too few steps determine its gain.
    """
    steps = list(_steps(log, axis))
    fits = _fit_all(steps, axis, odometry.values)
    values, std = _median(fits)
    if not np.isfinite(values[1]):
        return None
    # Reports of one speed share their rounding.
    speed = float(np.median([np.abs(step.commands).max() for step in steps]))
    std[1] = math.hypot(std[1], _resolution(log.motion[:, axis]) / math.sqrt(12.0) / speed)
    shifts = [
        (_median(_fit_all(steps, axis, odometry.values + change))[0] - values) / CHANGE
        for change in CHANGE * np.eye(2)
    ]
    shift = np.nan_to_num(np.column_stack(shifts))
    std = np.sqrt(np.square(std) + np.diag(shift @ odometry.covariance @ shift.T))
    values[2:] = DEFAULT_ACCELERATIONS[axis] * np.exp(values[2:])
    std[2:] *= values[2:]
    residual = float(np.median([fit.residual for fit in fits]))
    return Axis(values, np.where(np.isfinite(values), std, np.inf), residual)


def _median(fits: Sequence[_StepFit]) -> tuple[FloatArray, FloatArray]:
    """Return the medians (4,) of fits and their standard deviations; NaN where too few determine a value."""
    values, std = np.full(4, np.nan), np.full(4, np.nan)
    for place, column in enumerate(np.array([fit.values for fit in fits]).reshape(-1, 4).T):
        found = column[np.isfinite(column)]
        if len(found) >= MIN_STEPS:
            values[place] = np.median(found)
            # For an interval of ± 1.96 of it from few steps; that also covers the scatter of a median.
            std[place] = student(len(found) - 1) * np.std(found, ddof=1) / math.sqrt(len(found))
    return values, std


def _resolution(reported: FloatArray) -> float:
    """Return the smallest difference between two reported speeds."""
    gaps = np.diff(np.unique(np.round(np.abs(reported), 7)))
    return float(gaps.min()) if len(gaps) else 0.0


def _steps(log: MotionLog, axis: int) -> Iterator[_Step]:
    """Yield the steps of an axis: from a command after a rest to the next such."""
    sent = log.sent[:, axis]
    new = np.diff(sent, prepend=0.0) != 0.0
    times, commands = log.sent_s[new], sent[new]
    before = np.concatenate([[0.0], commands[:-1]])
    begins = np.flatnonzero((before == 0.0) & (np.diff(times, prepend=-math.inf) > PAUSE_S)).tolist()
    for begin, end in pairwise([*begins, len(times)]):
        if np.abs(commands[begin:end]).max() < MIN_MOTION[axis]:
            continue
        following = times[end] if end < len(times) else math.inf
        until = min(times[end - 1] + AFTER_S, following)
        inside = (log.odometry.t >= times[begin]) & (log.odometry.t <= until)
        yield _Step(times[begin:end], commands[begin:end], log.odometry.t[inside], log.motion[inside, axis])


def _fit_all(steps: Sequence[_Step], axis: int, errors: FloatArray) -> list[_StepFit]:
    """Return the fits of the steps that fit."""
    fits = [fit for step in steps if (fit := _fit(step, axis, errors)) is not None]
    sizes = np.array([fit.residual for fit in fits])
    limit = max(OUTLIER * float(np.quantile(sizes, 0.25)), MISFIT * SCALES[axis]) if fits else 0.0
    return [fit for fit in fits if fit.residual <= limit]


def _fit(step: _Step, axis: int, errors: FloatArray) -> _StepFit | None:
    """Fit one step; None if the best delay or gain is beyond any base's."""
    scale, default = SCALES[axis], DEFAULT_ACCELERATIONS[axis]
    if len(step.t) < 2 * len(DIFFERENCES):
        return None

    def residuals(x: FloatArray) -> FloatArray:
        motion = _modelled((step.times + x[0], step.commands), x[1], default * np.exp(x[2:]), errors, step.t)
        found: FloatArray = (motion - step.reported) / scale
        return found

    def jacobian(x: FloatArray) -> FloatArray:
        return np.column_stack(
            [
                (residuals(x + step) - residuals(x - step)) / (2.0 * step.max())
                for step in np.diag(DIFFERENCES)
            ]
        )

    # The fit of a short ramp has several minima.
    starts = (
        np.array([delay, 1.0, effort, effort])
        for delay in np.arange(0.0, DELAY_MAX_S, 0.04)
        for effort in (-0.7, 0.0, 1.5)
    )
    start = min(starts, key=lambda x: float(np.log1p(np.square(residuals(x) / 10.0)).sum()))
    least, most = np.log(BOUNDS).tolist()
    bounds = np.array([[0.0, 0.3, least, least], [DELAY_MAX_S, 3.0, most, most]])
    fit = least_squares(
        residuals, start, jacobian, bounds=bounds, loss="cauchy", x_scale=(0.05, 0.1, 0.2, 0.2)
    )
    x = fit.x
    room = np.minimum(x - bounds[0], bounds[1] - x)
    if room[1] < AT_BOUND or DELAY_MAX_S - x[0] < AT_BOUND:
        return None  # a delay of 0 at its bound is valid
    # Where commands change more slowly than the base could, they do not show an acceleration.
    shown = (np.linalg.norm(fit.jac, axis=0) > NEGLIGIBLE) & ((room >= AT_BOUND) | [True, True, False, False])
    residual = scale * float(np.sqrt(np.mean(np.square(residuals(x)))))
    return _StepFit(np.where(shown, x, np.nan), residual)


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
