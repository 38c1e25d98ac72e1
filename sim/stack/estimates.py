"""How well the driver of the stack simulation knows where its rover is, over many trials."""

import math
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.stats import chi2

from deploy.drive.config import settings_for
from deploy.drive.control_loop import Drive, Phase
from deploy.estimator.settings import EstimatorSettings
from rover_ncp.core.geometry import Pose, distance
from rover_ncp.robot.profile import RoverProfile
from sim.world.randomization import Randomization
from sim.world.skid_robot import SkidRanges

ELLIPSES = 0.5, 0.95
TYPICAL_RAD_S = 0.12
"""Of a turn on a course; slip is per rad/s."""
EXACT = 1e-4
"""Standard deviation of an error that a family of robots does not have."""
LOADED_TYRE = 0.004
"""A tyre under its load rolls on so much less than its radius (`tests/kit/rigid_body.py`)."""
DOWNHILL_M, GAIN_WALK = 0.25, 1.5
"""The slide downhill and the change of turn gain on a slope, over its tangent divided by friction, for the
families' centres of mass and directions: rms by Coulomb friction (`tests/kit/rigid_body.py`)."""
SKID_M, CABLE_M = 0.1, 0.026
"""The random part of that slide, in the same way, and the unseen way over a cable: fitted to other seeds."""
OFF_CENTRE_M = 0.06
"""Largest distance of the centre of mass from the middle in the families for which the next three hold."""
MORE_TURN, MORE_TURN_STD, BENT_M = 0.18, 0.16, 0.014
"""How much more than their encoders say such robots turn, mean and deviation, and the random way that stands
for how its error bends the path, which a filter of first order cannot tell: fitted to other seeds. It is
skewed: half of them turn less than 1.05 times as much, one 1.5 times. Only encoders alone need it; a gyro or
poses measure the gain."""
LEAST_TURN_STD = 0.02
"""A 3-AT with its weight in the middle turns 1.016 times as much."""


def settings_of(
    ranges: Randomization, known: RoverProfile, *, measured: bool, alone: bool
) -> EstimatorSettings:
    """Return the settings of a driver that knows the spread of its family's errors, and their noise.

    The spread of odometry's errors is that of the profile if they were ``measured``. With encoders ``alone``
    nothing else tells how far the rover turned.
    """
    settings = settings_for(known)
    spread = _of_ground(ranges.skid_steer) if ranges.skid_steer else {}
    means: dict[str, float] = {}
    if known.downhill_x_m is not None:
        spread.pop("downhill_std_m", None)
    if not measured:
        if ranges.skid_steer:
            wheels = ranges.skid_steer.wheel_radius / math.sqrt(3.0)
            spread["distance_gain_std"] = math.hypot(wheels, LOADED_TYRE)
            if alone:
                off = ranges.skid_steer.mass_center_m / OFF_CENTRE_M
                means["turn_gain"] = 1.0 + off * MORE_TURN
                spread["turn_gain_std"] = max(off * MORE_TURN_STD, LEAST_TURN_STD)
                spread["wander_m"] = math.hypot(spread["wander_m"], off * BENT_M)
        elif not ranges.turn_gain:
            means["slip_s"] = 0.5 * ranges.slip_s
            spread |= _of_plane(ranges)
    return settings.model_copy(update=means | {name: max(std, EXACT) for name, std in spread.items()})


def _of_ground(ranges: SkidRanges) -> dict[str, float]:
    least, most = ranges.slope_rad
    slope = math.sqrt((least * least + least * most + most * most) / 3.0 / math.prod(ranges.friction))
    usual = EstimatorSettings()
    return {
        "downhill_std_m": DOWNHILL_M * slope,
        "turn_gain_walk": math.hypot(usual.turn_gain_walk, GAIN_WALK * slope),
        "skid_m": math.hypot(usual.skid_m, SKID_M * slope),
        "wander_m": math.hypot(usual.wander_m, CABLE_M * math.sqrt(ranges.cables)),
    }


def _of_plane(ranges: Randomization) -> dict[str, float]:
    """Return the spreads of robots that do not skid."""
    usual = EstimatorSettings()
    scale = ranges.odometry_scale / math.sqrt(3.0)
    slip = 0.5 * ranges.slip_s * TYPICAL_RAD_S / math.sqrt(3.0)  # about its mean
    return {
        "distance_gain_std": scale,
        "turn_gain_std": math.hypot(scale, slip),
        "wheel_mismatch_std_rad_m": ranges.imbalance_rad_m / math.sqrt(3.0),
        "drift_std_rad_s": ranges.drift_rad_s / math.sqrt(3.0),
        # Their errors stay the same during a drive.
        "turn_gain_walk": 0.0,
        "rotation_center_walk_m": 0.0,
        "skid_m": 0.0,
        "skid_rad": 0.0,
        "rotation_center_std_m": ranges.rotation_center_m / math.sqrt(3.0),
        "downhill_std_m": 0.0,
        # The push comes once, in about a metre of driving.
        "wander_m": math.hypot(usual.wander_m, ranges.bump_m / math.sqrt(3.0)),
        "wander_rad": math.hypot(usual.wander_rad, ranges.bump_rad / math.sqrt(3.0)),
    }


class Belief(NamedTuple):
    """What the driver believes at the end of a drive, beside the truth."""

    parked: bool
    """Its own verdict."""
    error_m: float
    """Of its estimate against the true position; NaN if a safety rule stopped the drive."""
    squared: float
    """The same, squared and normalised by the estimate's covariance: χ² with 2 degrees of freedom."""
    predicted_m: float
    """Predicted error of the estimate, before the drive, in 95 % of drives; NaN if there was none."""
    nis: dict[str, float | None]
    """Of the external poses, as `deploy` reports it."""


def belief_of(drive: Drive, pose: Pose) -> Belief:
    """Return the belief of a driver whose rover ended at the true ``pose``."""
    error_m = squared = math.nan
    if drive.stop is None and drive.estimate is not None:
        estimate = drive.estimate
        miss = np.array([estimate.pose.x - pose.x, estimate.pose.y - pose.y])
        error_m = distance(estimate.pose, pose)
        squared = float(miss @ np.linalg.solve(estimate.covariance[:2, :2], miss))
    predicted_m = math.nan if drive.predicted_error_m is None else drive.predicted_error_m
    nis = drive.measurements_used["pose"]["nis"]
    return Belief(drive.phase is Phase.PARKED, error_m, squared, predicted_m, nis)


def summary(beliefs: Sequence[Belief], parked: Sequence[bool]) -> dict[str, Any]:
    """Return the estimates of drives that truly ended ``parked`` or not, as numbers for JSON."""
    squared = np.array([belief.squared for belief in beliefs if math.isfinite(belief.squared)])
    return {
        #: of the driver's estimate at the goal, against the truth
        "error_m": _percentiles([belief.error_m for belief in beliefs]),
        #: as deploy predicts it, without external poses
        "predicted_error_m": _percentiles([belief.predicted_m for belief in beliefs]),
        "inside": {  #: share of drives whose true position is inside the 50 % and the 95 % ellipse
            f"{share:.0%}": float(np.mean(squared <= chi2.ppf(share, 2))) if len(squared) else None
            for share in ELLIPSES
        },
        #: mean normalised innovation squared of external poses, while the rover stood and moved
        "nis": {name: _mean([belief.nis[name] for belief in beliefs]) for name in ("standing", "moving")},
        #: share of drives of which the driver's verdict is the true one
        "verdict_agrees": float(np.mean([belief.parked for belief in beliefs] == np.array(parked))),
    }


def words(fields: dict[str, Any]) -> Iterator[str]:
    """Yield lines about a `summary`."""
    error, predicted, inside = fields["error_m"], fields["predicted_error_m"], fields["inside"]
    if error is not None:
        yield (
            f"estimate against truth: median {1000 * error['p50']:.0f}, 95th percentile "
            f"{1000 * error['p95']:.0f} mm; inside its 50 % ellipse {inside['50%']:.0%}, "
            f"its 95 % ellipse {inside['95%']:.0%}"
        )
    if predicted is not None:
        yield f"predicted before the drive, without external poses: {1000 * predicted['p50']:.0f} mm in 95 %"
    yield f"the driver's own verdict agrees with the truth: {fields['verdict_agrees']:.1%}"


def _percentiles(values: Sequence[float]) -> dict[str, float] | None:
    known = [value for value in values if math.isfinite(value)]
    if not known:
        return None
    p50, p95 = np.percentile(known, [50, 95]).tolist()
    return {"p50": p50, "p95": p95}


def _mean(values: Sequence[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return float(np.mean(known)) if known else None
