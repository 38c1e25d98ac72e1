"""The driver's estimate at the end of a stack simulation against the truth, over many trials."""

import math
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.stats import chi2

from deploy.drive.control_loop import Drive
from rover_ncp.core.geometry import Pose, distance
from rover_ncp.course.course import Parked

ELLIPSES = 0.5, 0.95


class Belief(NamedTuple):
    """The driver's verdict and estimate at the end of a drive."""

    verdict: Parked | None
    """The driver's; None if a safety rule stopped the drive."""
    error_m: float
    """Position error of the estimate; NaN if a safety rule stopped the drive."""
    squared: float
    """Squared error, normalised by the estimate's covariance: χ² with 2 degrees of freedom."""
    predicted_m: float
    """Error of the estimate predicted before the drive (95 %); NaN if there was no prediction."""
    nis: dict[str, float | None]
    """Normalised innovation squared of the external poses, as `deploy` reports it."""


def belief_of(drive: Drive, pose: Pose) -> Belief:
    """Return the belief of a driver whose rover ended at the true ``pose``."""
    error_m = squared = math.nan
    if drive.stop is None and drive.estimate is not None:
        estimate = drive.estimate
        error = np.array([estimate.pose.x - pose.x, estimate.pose.y - pose.y])
        error_m = distance(estimate.pose, pose)
        squared = float(error @ np.linalg.solve(estimate.covariance[:2, :2], error))
    predicted_m = math.nan if drive.predicted_error_m is None else drive.predicted_error_m
    nis = drive.measurements_used["pose"]["nis"]
    verdict = None if drive.verdict is None else drive.verdict.words
    return Belief(verdict, error_m, squared, predicted_m, nis)


def summary(beliefs: Sequence[Belief], parked: Sequence[bool]) -> dict[str, Any]:
    """Return the estimates of drives that truly ended ``parked`` or not, as numbers for JSON."""
    sure = np.array([belief.verdict is Parked.YES for belief in beliefs])
    denied = np.array([belief.verdict in {None, Parked.NO} for belief in beliefs])
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
        #: share of drives of which the driver's verdict is parked or not parked, and true
        "verdict_agrees": float(np.mean(np.where(parked, sure, denied))),
        #: share of drives of which the driver's verdict is "parked, uncertain"
        "verdict_uncertain": float(np.mean([belief.verdict is Parked.UNCERTAIN for belief in beliefs])),
        #: share of the verdicts parked that are false; null if there is none
        "quiet_misses": float(np.mean(~np.array(parked)[sure])) if sure.any() else None,
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
    yield (
        f"the driver's own verdict is true: {fields['verdict_agrees']:.1%}, "
        f"uncertain: {fields['verdict_uncertain']:.1%}"
    )
    if fields["quiet_misses"] is not None:
        yield f"not parked although the driver's verdict is parked: {fields['quiet_misses']:.1%} of these"


def _percentiles(values: Sequence[float]) -> dict[str, float] | None:
    known = [value for value in values if math.isfinite(value)]
    if not known:
        return None
    p50, p95 = np.percentile(known, [50, 95]).tolist()
    return {"p50": p50, "p95": p95}


def _mean(values: Sequence[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return float(np.mean(known)) if known else None
