"""What a base makes of commands, from a record of its motion: delays, accelerations, gains, noise, slip.

The model of an axis (speed, rate of turn) is the simulator's: what was sent takes effect after a delay,
times a gain, and the motion goes there no quicker than an acceleration. The fit is a least-squares one on the
speeds that odometry reports, with a loss that lets single lost commands not count. So gains are those that
odometry sees. How wrong odometry is itself (its scales, unseen slip and imbalance) only shows beside poses
from outside; they are compared where the rover stood, so that no clock matters.
"""

import math
from collections.abc import Sequence
from functools import lru_cache
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from deploy.motion_log import MotionLog
from rover_ncp.core.profile import RoverProfile

__all__ = ["Axis", "identify", "identify_axis"]

FloatArray = NDArray[np.float64]

GRID_S = 0.005
"""Step of the model; commands are held in between."""
DELAY_MAX_S = 0.8
SCALES = (0.004, 0.01)
"""Residuals of v (m/s) and omega (rad/s) beyond which a sample counts less: some steps of the reports."""
USUAL = (0.31, 1.25)
"""Where the search for the accelerations begins, m/s² and rad/s²."""
BOUNDS = (0.05, 20.0)
"""Of the accelerations, as factors on the usual ones."""
LEAST_MOTION = (0.05, 0.08)
"""An axis that was never asked for more than this, in m/s and rad/s, says nothing."""
SURE_DELAY_S, SURE_GAIN = 0.03, 0.03
"""Standard deviations beyond which a number is not known."""
SPOILT = 10.0
"""A residual of so many scales or more is a command that was lost: left out at the end."""

STANDING_M_S, STANDING_RAD_S = 0.004, 0.006
STANDING_S = 0.35
"""So long the rover stands before its pose counts, and at least so long after."""
LEAST_WAY_M = 0.1
WAY_M, TURN_RAD = 0.004, 0.005
"""What ways and turns between two stands may be off by, with poses that are good to 5 mm and 0.5°."""
SLIP_COST = 3.0
STEP_M, STEP_RAD = 0.001, math.tau / 4096
"""What positions and headings are rounded to."""


class Axis(NamedTuple):
    """One axis: s, m/s² or rad/s², and a factor; then their standard deviations and the residual's (SI)."""

    delay_s: float
    acceleration: float
    gain: float
    delay_std: float
    acceleration_std: float
    gain_std: float
    residual: float


def identify(log: MotionLog, name: str) -> RoverProfile:
    """Return the profile of the base that a record is of; what cannot be told from it is None."""
    found: dict[str, Any] = {}
    measured: dict[str, Any] = {
        "samples": len(log.odometry.t),
        "seconds": round(float(log.odometry.t[-1]), 1),
    }
    for axis, (delay, acceleration, gain) in enumerate(
        (("delay_v_s", "accel", "gain_v"), ("delay_omega_s", "alpha", "gain_omega"))
    ):
        fitted = identify_axis(log, axis)
        if fitted is None:
            continue
        sure = fitted.delay_std < SURE_DELAY_S, fitted.gain_std < SURE_GAIN * fitted.gain
        if sure[0]:
            found |= {delay: fitted.delay_s, acceleration: fitted.acceleration}
        if sure[1]:
            found[gain] = fitted.gain
        measured[("v", "omega")[axis]] = {
            "delay_std_s": fitted.delay_std,
            "acceleration_std": fitted.acceleration_std,
            "gain_std": fitted.gain_std,
            "residual": fitted.residual,
        }
    stands = _stands(log)
    found |= _noise(log, stands)
    if len(log.external.t):
        found |= _beside_external(log, stands)
        measured["external_poses"] = len(log.external.t)
    rounded = {key: float(f"{value:.5g}") for key, value in found.items()}
    return RoverProfile.model_validate({"name": name, "measured": measured} | rounded)


def identify_axis(log: MotionLog, axis: int) -> Axis | None:
    """Return what axis 0 (v) or 1 (omega) does; None if it was hardly asked for anything."""
    if float(np.abs(log.sent[:, axis]).max()) < LEAST_MOTION[axis]:
        return None
    grid = np.arange(min(log.sent_s[0], 0.0) - DELAY_MAX_S, log.odometry.t[-1] + GRID_S, GRID_S)
    asked = _held(log.sent_s, log.sent[:, axis], grid)
    t, reported = log.odometry.t, log.motion[:, axis]
    scale, usual = SCALES[axis], USUAL[axis]

    @lru_cache(maxsize=4)
    def shape(step: float) -> FloatArray:
        return _followed(asked, step)

    def residuals(x: FloatArray, kept: Any = slice(None)) -> FloatArray:
        delay, gain, acceleration = x[0], x[1], usual * math.exp(x[2])
        followed = shape(GRID_S * acceleration / gain)
        misses: FloatArray = (gain * np.interp(t - delay, grid, followed) - reported) / scale
        chosen: FloatArray = misses[kept]
        return chosen

    first = min(
        (np.array([delay, 1.0, 0.0]) for delay in np.arange(0.0, DELAY_MAX_S, 0.02)),
        key=lambda x: float(np.log1p(np.square(residuals(x) / SPOILT)).sum()),
    )
    log_low, log_high = math.log(BOUNDS[0]), math.log(BOUNDS[1])
    bounds = [0.0, 0.3, log_low], [DELAY_MAX_S, 3.0, log_high]
    fit: Any = None
    kept: Any = np.ones(len(t), np.bool_)
    for loss in ("cauchy", "soft_l1"):
        begin = first if fit is None else fit.x
        fit = least_squares(
            residuals, begin, bounds=bounds, loss=loss, x_scale=(0.05, 0.1, 0.2), diff_step=1e-3, args=(kept,)
        )
        kept = np.abs(residuals(fit.x)) < SPOILT
    spread = _deviations(fit.jac, residuals(fit.x, kept))
    delay, gain, acceleration = float(fit.x[0]), float(fit.x[1]), usual * math.exp(fit.x[2])
    return Axis(
        delay,
        acceleration,
        gain,
        float(spread[0]),
        float(spread[2]) * acceleration,
        float(spread[1]),
        float(scale * np.sqrt(np.mean(np.square(residuals(fit.x, kept))))),
    )


def _held(times: FloatArray, values: FloatArray, grid: FloatArray) -> FloatArray:
    """Return values (len(grid),) of steps that hold until the next, 0 before the first."""
    place = np.searchsorted(times, grid + 1e-9, side="right") - 1
    return np.where(place < 0, 0.0, values[np.maximum(place, 0)])


def _followed(asked: FloatArray, step: float) -> FloatArray:
    """Return what follows ``asked`` by at most ``step`` from one place to the next."""
    speed, followed = 0.0, []
    for wanted in asked.tolist():
        speed = min(max(wanted, speed - step), speed + step)
        followed.append(speed)
    return np.array(followed)


def _deviations(jacobian: FloatArray, residuals: FloatArray) -> FloatArray:
    """Return the parameters' standard deviations; infinite where the record does not tell."""
    count, size = jacobian.shape
    variance = max(float(residuals @ residuals) / max(count - size, 1), 1e-3)
    curvature = jacobian.T @ jacobian
    if np.linalg.cond(curvature) > 1e12:
        return np.full(size, np.inf)
    deviations: FloatArray = np.sqrt(variance * np.diag(np.linalg.inv(curvature)))
    return deviations


def _stands(log: MotionLog) -> list[tuple[float, float]]:
    """Return from when to when the rover stood for certain, by odometry's speeds."""
    t = log.odometry.t
    still = (np.abs(log.motion) < (STANDING_M_S, STANDING_RAD_S)).all(axis=1)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], still.astype(int), [0]])))
    spans = [(t[a] + STANDING_S, t[b - 1]) for a, b in zip(edges[::2], edges[1::2], strict=True)]
    return [(float(a), float(b)) for a, b in spans if b - a >= STANDING_S]


def _noise(log: MotionLog, stands: Sequence[tuple[float, float]]) -> dict[str, float]:
    """Return how far poses scatter while the rover stands, beyond their rounding.

    Only between drives: a base may report otherwise before its motors are on.
    """
    squares, count = np.zeros(3), 0
    for a, b in stands[1:-1]:
        inside = (log.odometry.t >= a) & (log.odometry.t <= b)
        poses = log.odometry.poses[inside]
        squares += np.square(poses - poses.mean(axis=0)).sum(axis=0)
        count += len(poses) - 1
    if count < 20:
        return {}
    variance = squares / count
    rounding = np.square([STEP_M, STEP_RAD]) / 12.0
    beyond = np.maximum(np.array([variance[:2].mean(), variance[2]]) - rounding, 0.0)
    noise_m, noise_rad = np.sqrt(beyond).tolist()
    return {
        "noise_m": noise_m if noise_m > STEP_M / 2 else 0.0,
        "noise_rad": noise_rad if noise_rad > STEP_RAD / 2 else 0.0,
    }


def _beside_external(log: MotionLog, stands: Sequence[tuple[float, float]]) -> dict[str, float]:
    """Return what odometry gets wrong, from where the rover stood by it and by external poses."""
    found: list[tuple[float, float, FloatArray, FloatArray]] = []
    for a, b in stands:
        inside, outside = (_within(track.t, a, b) for track in (log.odometry, log.external))
        if inside.sum() >= 3 and outside.sum() >= 3:
            own, true = log.odometry.poses[inside], log.external.poses[outside]
            found.append((a, b, own.mean(axis=0), true.mean(axis=0)))
    straight, turns = [], []
    for (_, began, own_a, true_a), (ended, _, own_b, true_b) in pairwise(found):
        way, true_way = (math.hypot(*(q - p)[:2]) for p, q in ((own_a, own_b), (true_a, true_b)))
        span = _within(log.odometry.t, began, ended)
        v, omega = log.motion[span].T
        gap = np.diff(log.odometry.t[span], append=ended)
        if way > LEAST_WAY_M:
            straight.append((way, true_way))
        turn, true_turn = own_b[2] - own_a[2], true_b[2] - true_a[2]
        true_turn += math.tau * round((turn - true_turn) / math.tau)
        forward = float((v * gap).sum())
        turns.append((turn, true_turn, float((np.abs(omega) * omega * gap).sum()), forward))
    answer: dict[str, float] = {}
    if len(straight) >= 3:
        answer["odometry_distance"] = _ratio(np.array(straight))
    if len(turns) >= 6:
        answer |= _turning(np.array(turns))
    return answer


def _ratio(ways: FloatArray) -> float:
    """Return odometry's ways over true ones, rows (way, true way); a push on one of them counts little."""
    fit = least_squares(lambda x: (x[0] * ways[:, 1] - ways[:, 0]) / WAY_M, [1.0], loss="soft_l1")
    return float(fit.x[0])


def _turning(turns: FloatArray) -> dict[str, float]:
    """Fit turn = scale · (true turn + slip · ∫|ω|ω − imbalance · way), rows (turn, true, ∫|ω|ω, way).

    Slip and scale are hard to tell apart: slip is only believed where it explains a good deal more.
    """
    turn, true, squared, way = turns.T

    def residuals(x: FloatArray) -> FloatArray:
        scale, imbalance, *slip = x
        slipped = slip[0] * squared if slip else 0.0
        misses: FloatArray = (scale * (true + slipped - imbalance * way) - turn) / TURN_RAD
        return misses

    plain = least_squares(residuals, [1.0, 0.0], loss="soft_l1")
    best = least_squares(
        residuals, [1.0, 0.0, 0.1], bounds=([0.5, -1.0, 0.0], [2.0, 1.0, 3.0]), loss="soft_l1"
    )
    slips = plain.cost - best.cost > SLIP_COST
    fit = best if slips else plain
    answer = {"odometry_heading": float(fit.x[0]), "slip_s": float(fit.x[2]) if slips else 0.0}
    if np.ptp(way) > LEAST_WAY_M:
        answer["imbalance_rad_m"] = float(fit.x[1])
    return answer


def _within(t: FloatArray, a: float, b: float) -> NDArray[np.bool_]:
    return (t >= a) & (t <= b)
