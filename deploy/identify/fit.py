"""A robot's profile from a record of its motion: delays, accelerations, gains, noise and odometry's errors.

Each fitted value has a standard deviation; a value with too large a one is left out. Gains are those that
odometry measures; accelerations are true ones. Odometry's errors (scales, slip, wheel mismatch, centre of
rotation) need external poses. Without them, default standard deviations of scales and slip are assumed.
"""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from deploy.identify.axis_fit import identify_axis
from deploy.identify.excitation import DeadBands
from deploy.identify.motion_log import MotionLog
from deploy.identify.odometry_fit import (
    STEP_M,
    STEP_RAD,
    Fit,
    fit_center,
    fit_distance,
    fit_turns,
    scatter,
    standstills_with_poses,
)
from rover_ncp.robot.profile import RoverProfile

STANDING_M_S, STANDING_RAD_S = 0.004, 0.006
STANDING_S = 0.35
"""A stand begins this long after the last motion, and lasts at least as long."""
ROCKING_S = 0.35
"""A shorter motion ends no stand."""
MIN_NOISE_SAMPLES = 20

SCALE_STD = 0.0173
"""Standard deviation of odometry's scales without external poses: uniform within ±3 %."""
SLIP_STD_S = 0.17
"""Standard deviation of a turn's slip about 0: uniform from 0 to 0.3 s (preset `harsh`)."""

MAX_STD_SHARE = {
    **dict.fromkeys(("gain_v", "gain_omega", "odometry_distance"), 0.03),
    "odometry_heading": 0.1,
    **dict.fromkeys(("accel", "decel", "alpha", "alpha_decel"), 0.15),
    **dict.fromkeys(("noise_m", "noise_rad"), 0.25),
}
"""Largest standard deviation that is kept, as a share of the value."""
MAX_STD = {
    **dict.fromkeys(("downhill_x_m", "downhill_y_m"), 0.01),
    **dict.fromkeys(("delay_v_s", "delay_omega_s", "wheel_mismatch_rad_m"), 0.03),
    **dict.fromkeys(("rotation_center_m", "rotation_center_left_m"), 0.03),
    "turn_asymmetry": 0.05,
    "slip_s": 0.15,
}
"""Largest standard deviation of the other values, SI."""

_AXES = ("delay_v_s", "gain_v", "accel", "decel"), ("delay_omega_s", "gain_omega", "alpha", "alpha_decel")
_BANDS = "dead_band_v", "dead_band_omega"


class _Value(NamedTuple):
    value: float
    std: float


def identify(log: MotionLog, name: str, bands: DeadBands = (None, None)) -> RoverProfile:
    """Return the base's profile from a record and its dead bands; an uncertain value is None."""
    measured: dict[str, Any] = {
        "samples": len(log.odometry.t),
        "seconds": round(float(log.odometry.t[-1]), 1),
    }
    stands = _stands(log)
    found = _noise(log, stands)
    odometry = (
        Fit(np.array([1.0, 0.0]), np.diag([SCALE_STD**2, 0.0])),
        Fit(np.array([1.0, 0.0]), np.diag([SCALE_STD**2, SLIP_STD_S**2])),
    )
    if len(log.external.t):
        measured["external_poses"] = len(log.external.t)
        standstills = standstills_with_poses(log, stands)
        if way := fit_distance(standstills):
            found |= _named(("odometry_distance",), way)
            odometry = Fit(np.append(way.values, 0.0), np.pad(way.covariance, (0, 1))), odometry[1]
        if turn := fit_turns(log, standstills):
            names = "odometry_heading", "slip_s", "wheel_mismatch_rad_m", None, "turn_asymmetry"
            found |= _named(names, turn)
            odometry = odometry[0], Fit(turn.values[:2], turn.covariance[:2, :2])
            # Poses that do not turn with the robot are those of another object: they show no centre either.
            if center := fit_center(standstills):
                centers = "rotation_center_m", "rotation_center_left_m"
                found |= _named((*centers, "downhill_x_m", "downhill_y_m"), center)
    found |= {key: _Value(band, 0.0) for key, band in zip(_BANDS, bands, strict=True) if band is not None}
    obeyed = np.where(np.abs(log.sent) < 0.999 * np.array([band or 0.0 for band in bands]), 0.0, log.sent)
    log = log._replace(sent=obeyed)
    for axis, keys in enumerate(_AXES):
        fitted = identify_axis(log, axis, odometry[axis])
        if fitted is not None:
            values = map(_Value, fitted.values.tolist(), fitted.std.tolist())
            found |= dict(zip(keys, values, strict=True))
            measured[("v", "omega")[axis]] = {"residual": float(f"{fitted.residual:.3g}")}
    sure = {key: value for key, value in found.items() if _sure(key, value)}
    return RoverProfile.model_validate(
        {
            "name": name,
            "measured": measured,
            "std": {key: float(f"{std:.3g}") for key, (_, std) in sure.items() if std > 0.0},
        }
        | {key: float(f"{value:.5g}") for key, (value, _) in sure.items()}
    )


def _named(names: Sequence[str | None], fit: Fit) -> dict[str, _Value]:
    """Return the values of a fit that have a name."""
    deviations = np.sqrt(np.diag(fit.covariance)).tolist()
    values = map(_Value, fit.values.tolist(), deviations)
    return {name: value for name, value in zip(names, values, strict=True) if name}


def _sure(key: str, found: _Value) -> bool:
    """Return whether a value is certain enough to be of use."""
    max_std = MAX_STD[key] if key in MAX_STD else MAX_STD_SHARE.get(key, 0.0) * found.value
    return found.std <= max_std


def _stands(log: MotionLog) -> list[tuple[float, float]]:
    """Return the intervals (s) in which the rover stood, by odometry's speeds.

    Soft tyres rock for a moment after a turn, which ends no stand.
    """
    t = log.odometry.t
    still = (np.abs(log.motion) < (STANDING_M_S, STANDING_RAD_S)).all(axis=1)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], still.astype(int), [0]])))
    begins, ends = t[edges[::2]], t[edges[1::2] - 1]
    apart = begins[1:] - ends[:-1] > ROCKING_S
    firsts, lasts = [*begins[:1], *begins[1:][apart]], [*ends[:-1][apart], *ends[-1:]]
    spans = [(first + STANDING_S, last) for first, last in zip(firsts, lasts, strict=True)]
    return [(float(a), float(b)) for a, b in spans if b - a >= STANDING_S]


def _noise(log: MotionLog, stands: Sequence[tuple[float, float]]) -> dict[str, _Value]:
    """Return how far poses scatter while the rover stands, beyond their rounding.

    The first and last stand are left out: a base may report differently while its motors are off. Noise below
    the rounding is 0.
    """
    poses = [log.odometry.between(a, b) for a, b in stands[1:-1]]
    count = sum(len(rows) - 1 for rows in poses)
    if count < MIN_NOISE_SAMPLES:
        return {}
    variance, found = scatter(poses), {}
    for key, seen, step, samples in (
        ("noise_m", float(variance[:2].mean()), STEP_M, 2 * count),
        ("noise_rad", float(variance[2]), STEP_RAD, count),
    ):
        noise = math.sqrt(max(seen - step**2 / 12.0, 0.0))
        # The deviation of a Gaussian's sample variance is that variance times √(2 / samples).
        found[key] = (
            _Value(noise, seen / noise / math.sqrt(2.0 * samples)) if noise > step / 2.0 else _Value(0.0, 0.0)
        )
    return found
