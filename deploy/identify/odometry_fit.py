"""Errors of odometry, from its poses of a standing rover and external poses.

Only poses of a standing rover are compared, so external poses may be late by a third of a second. The
distance and the turn between one stand and the next contain the noise of both stands' means, and neighbouring
intervals share a stand. So the fits are generalised least squares with that covariance. An interval with a
disturbance is an outlier and is left out. Only straight intervals give distances.
"""

import math
from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular
from scipy.optimize import least_squares
from scipy.special import ndtri, stdtrit

from deploy.identify.motion_log import FloatArray, MotionLog

MIN_DISTANCE_M = 0.1
STRAIGHT_RAD = 0.1
"""On a straight way, headings differ by no more from that at its begin."""
NOISE_SIGMAS = 4.0
"""Limit for the noise of some hundred headings, in standard deviations."""
MIN_POSES = 3
"""Of odometry and of external poses in a stand."""
DISTURBED = float(ndtri(0.9995))
"""An interval with a larger standardised residual counts as disturbed: one in 1000 by chance."""
STEP_M, STEP_RAD = 0.001, math.tau / 4096
"""Resolution of odometry's positions and headings."""
PLAUSIBLE = 0.5, 2.0
"""Plausible scales of odometry; external poses that give others belong to another object."""
SLIP_MAX_S = 3.0
CENTER_MAX_M = 0.5
ASYMMETRY_MAX = 0.5
EXACT_M = 1e-4
"""External poses are no more exact than this, even if they do not scatter."""
SPOT_M, MIN_TURN_RAD = 0.03, 0.1
"""On less way and with more turn than this, the rover turned on the spot."""


class Fit(NamedTuple):
    """Values (k,) with their covariance (k, k)."""

    values: FloatArray
    covariance: FloatArray


class Stand(NamedTuple):
    """The rover stood from ``begin_s`` to ``end_s``: mean poses with their variances of x, y and theta."""

    begin_s: float
    end_s: float
    own: FloatArray
    true: FloatArray
    own_variance: FloatArray
    true_variance: FloatArray
    veered: float = 0.0
    """How far, beyond noise, odometry's heading differs from this stand's until the next stand, rad."""


def student(free: int) -> float:
    """Return by how much the 95 % interval is wider for a deviation from so many degrees of freedom."""
    return float(stdtrit(free, 0.975) / ndtri(0.975))


def scatter(poses: Sequence[FloatArray]) -> FloatArray:
    """Return the variance (3,) of poses about the mean of their stand."""
    squares = sum((np.square(rows - rows.mean(axis=0)).sum(axis=0) for rows in poses), np.zeros(3))
    found: FloatArray = squares / sum(len(rows) - 1 for rows in poses)
    return found


def standstills_with_poses(log: MotionLog, spans: Sequence[tuple[float, float]]) -> list[Stand]:
    """Return the stands with both kinds of poses; their noise is pooled over all stands.

    The lasting error of the external poses does not average out in a stand. It counts as independent from
    stand to stand, which is pessimistic for those that follow within its time constant.
    """
    inside: list[tuple[float, float, FloatArray, FloatArray]] = []
    for begin, end in spans:
        own, true = log.odometry.between(begin, end), log.external.between(begin, end)
        if min(len(own), len(true)) >= MIN_POSES:
            inside.append((begin, end, own, true))
    if not inside:
        return []
    begins = [*(row[0] for row in inside[1:]), inside[-1][1]]
    t, headings = log.odometry.t, log.odometry.poses[:, 2]
    error = log.lasting.values
    lasting = np.square([error.position_m, error.position_m, error.heading_rad])
    own_noise, true_noise = scatter([row[2] for row in inside]), scatter([row[3] for row in inside])
    rounding = np.square([STEP_M, STEP_M, STEP_RAD]) / 12.0
    return [
        Stand(
            begin,
            end,
            own.mean(axis=0),
            true.mean(axis=0),
            # The mean of reports that do not scatter is still rounded.
            np.maximum(own_noise / len(own), np.where(own_noise > 3.0 * rounding, 0.0, rounding)),
            true_noise / len(true) + lasting,
            float(np.abs(headings[(t >= end) & (t <= until)] - own[:, 2].mean()).max())
            - NOISE_SIGMAS * math.sqrt(own_noise[2]),
        )
        for (begin, end, own, true), until in zip(inside, begins, strict=True)
    ]


def fit_distance(stands: Sequence[Stand]) -> Fit | None:
    """Fit odometry's distance = scale · true distance over straight intervals; None from fewer than three."""
    lengths, true_lengths, directions, rows = [], [], [], []
    for row, (a, b) in enumerate(pairwise(stands)):
        own, true = (b.own - a.own)[:2], (b.true - a.true)[:2]
        length, sigma = math.hypot(*own), math.sqrt(a.own_variance[2] + b.own_variance[2])
        veered = max(a.veered, abs(b.own[2] - a.own[2]) - NOISE_SIGMAS * sigma)
        if length > MIN_DISTANCE_M and veered < STRAIGHT_RAD:
            lengths.append(length)
            true_lengths.append(math.hypot(*true))
            directions.append(own / length)
            rows.append(row)
    if len(lengths) < 3:
        return None
    measured, true_length = np.array(lengths), np.array(true_lengths)
    variances = np.array([(stand.own_variance + stand.true_variance)[:2].mean() for stand in stands])
    covariance = _difference_covariance(rows, variances, [float(a @ b) for a, b in pairwise(directions)])
    return _fitted(
        lambda x, kept: (x[0] * true_length - measured)[kept], [1.0], covariance, [(0.0, math.inf)]
    )


def fit_turns(log: MotionLog, stands: Sequence[Stand]) -> Fit | None:
    """Fit heading scale, slip (s), wheel mismatch (rad/m), drift (rad/s) and asymmetry, in this order.

    turn = scale · (true turn + slip · ∫|ω|ω dt − mismatch · distance − asymmetry · |true turn|)
    + drift · time. The asymmetry belongs to the ground: on a slope, gravity turns a rover with its weight off
    the middle to one side as its tyres slide. None from fewer than seven intervals.
    """
    turns, true_turns, motions, distances, seconds = [], [], [], [], []
    times, (v, omega) = log.odometry.t, log.motion.T
    for a, b in pairwise(stands):
        turn, true_turn = b.own[2] - a.own[2], b.true[2] - a.true[2]
        turns.append(turn)
        true_turns.append(true_turn + math.tau * round((turn - true_turn) / math.tau))
        span = (times >= a.begin_s) & (times <= b.end_s)
        motions.append((times[span], omega[span]))
        distances.append(float(np.trapezoid(v[span], times[span])))
        seconds.append((b.begin_s + b.end_s - a.begin_s - a.end_s) / 2.0)
    if len(turns) < 7:
        return None
    columns = turns, true_turns, distances, seconds
    turn, true_turn, distance, second = (np.array(column) for column in columns)

    def residuals(x: FloatArray, kept: NDArray[np.bool_]) -> FloatArray:
        scale, slip, mismatch, drift, asymmetry = x
        slipped = np.array([_slipped(times, rate / scale, slip, asymmetry) for times, rate in motions])
        missing = mismatch * distance + asymmetry * np.abs(true_turn)
        found: FloatArray = scale * (true_turn + slip * slipped - missing) + drift * second - turn
        return found[kept]

    variances = np.array([(stand.own_variance + stand.true_variance)[2] for stand in stands])
    covariance = _difference_covariance(range(len(turn)), variances, np.ones(len(turn) - 1))
    free = -math.inf, math.inf
    limits = [(0.0, math.inf), (0.0, SLIP_MAX_S), free, free, (-ASYMMETRY_MAX, ASYMMETRY_MAX)]
    # From the fit without slip, which is linear: from elsewhere, the fit may end where slip takes all.
    design = np.column_stack([true_turn, -distance, second, -np.abs(true_turn)])
    scale, mismatch, drift, to_left = np.linalg.lstsq(design, turn, rcond=None)[0].tolist()
    if scale <= 0.0 or abs(to_left) >= ASYMMETRY_MAX * scale:
        return None
    return _fitted(residuals, [scale, 0.01, mismatch / scale, drift, to_left / scale], covariance, limits)


def fit_center(stands: Sequence[Stand]) -> Fit | None:
    """Fit the centre of rotation (m, behind the middle and to its left), and the slide downhill (m/rad).

    Turning on the spot from heading a to b moves the rover by behind · (cos b − cos a, sin b − sin a) +
    left · (sin b − sin a, cos a − cos b) + slide · |b − a|. The slide's x points along the first stand's
    heading. None from fewer than three turns.
    """
    heading = stands[0].true[2] if stands else 0.0
    ahead, left = (math.cos(heading), math.sin(heading)), (-math.sin(heading), math.cos(heading))
    moves, arcs, rows = [], [], []
    for row, (a, b) in enumerate(pairwise(stands)):
        spot = math.hypot(*(b.own - a.own)[:2]) < SPOT_M
        if spot and abs(b.own[2] - a.own[2]) > MIN_TURN_RAD:
            moves.append((b.true - a.true)[:2])
            arc = math.cos(b.true[2]) - math.cos(a.true[2]), math.sin(b.true[2]) - math.sin(a.true[2])
            angle = abs(b.true[2] - a.true[2])
            side = arc[1], -arc[0]
            arcs += [[arc[i], side[i], angle * ahead[i], angle * left[i]] for i in range(2)]
            rows.append(row)
    if len(rows) < 3:
        return None
    variances = np.array([max(stand.true_variance[:2].mean(), EXACT_M**2) for stand in stands])
    covariance = _difference_covariance(rows, variances, np.ones(len(rows) - 1))
    both = np.kron(covariance, np.eye(2)).astype(np.float64)
    move, design = np.ravel(moves), np.array(arcs)
    limits = -CENTER_MAX_M, CENTER_MAX_M
    return _fitted(lambda x, kept: (design @ x - move)[kept], [0.0] * 4, both, [limits] * 4, limits)


def _difference_covariance(
    rows: Sequence[int], variances: FloatArray, alignment: Sequence[float] | FloatArray
) -> FloatArray:
    """Return the covariance of differences between stands ``rows`` and the next; neighbours share a stand."""
    first = np.array(rows)
    covariance = np.diag(variances[first] + variances[first + 1])
    for i in np.flatnonzero(np.diff(first) == 1).tolist():
        covariance[i, i + 1] = covariance[i + 1, i] = -alignment[i] * variances[first[i + 1]]
    return covariance


def _slipped(times: FloatArray, rate: FloatArray, slip: float, asymmetry: float) -> float:
    """Return ∫|ω|ω dt of the true turn rate, where odometry without its scale saw ``rate``."""
    size, without_slip = np.abs(rate), 1.0 - asymmetry * np.sign(rate)
    true = 2.0 * size / (without_slip + np.sqrt(without_slip**2 + 4.0 * slip * size))
    return float(np.trapezoid(np.sign(rate) * np.square(true), times))


def _fitted(
    residuals: Callable[[FloatArray, NDArray[np.bool_]], FloatArray],
    start: Sequence[float],
    covariance: FloatArray,
    limits: Sequence[tuple[float, float]],
    plausible: tuple[float, float] = PLAUSIBLE,
) -> Fit | None:
    """Fit, leave out the worst row while it is an outlier, and fit again; None if nothing fits.

    The covariance of the values is the larger of that by the poses' noise and that by the residuals.
    """
    kept = np.ones(len(covariance), np.bool_)
    x = np.array(start)
    bounds = tuple(np.array(limits).T)
    while True:
        root = np.linalg.cholesky(covariance[np.ix_(kept, kept)])
        fit = least_squares(
            lambda x, kept, root: solve_triangular(root, residuals(x, kept), lower=True),
            x,
            bounds=bounds,
            args=(kept, root),
            x_scale="jac",
        )
        x = fit.x
        # Slip and scale may be at their lower limit, which is 0; other values at a limit were not found.
        at_limit = (fit.active_mask > 0) | ((fit.active_mask < 0) & (bounds[0] < 0.0))
        if not plausible[0] < x[0] < plausible[1] or at_limit.any():
            return None
        curvature = fit.jac.T @ fit.jac
        free = int(kept.sum()) - len(x)
        if free < 1 or not np.linalg.cond(curvature) < 1e14:
            return None
        values = np.linalg.inv(curvature)
        # Of what remains of each interval: precision-weighted residual over its standard deviation.
        precision = np.linalg.inv(covariance[np.ix_(kept, kept)])
        jacobian = root @ fit.jac
        weight = precision - precision @ jacobian @ values @ jacobian.T @ precision
        with np.errstate(divide="ignore", invalid="ignore"):
            sizes = np.abs(weight @ residuals(x, kept)) / np.sqrt(np.diag(weight))
        sizes = np.nan_to_num(sizes, posinf=0.0)
        worst = int(np.argmax(sizes))
        if sizes[worst] <= DISTURBED or free <= 2:
            # A small disturbance is a misfit beyond the noise of the poses, estimated from few intervals:
            # Student's quantile replaces 1.96.
            misfit = 2.0 * fit.cost / free
            return Fit(x, values * (misfit * student(free) ** 2 if misfit > 1.0 else 1.0))
        kept[np.flatnonzero(kept)[worst]] = False
