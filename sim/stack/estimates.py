"""The driver's estimate at the end of a stack simulation against the truth, over many trials."""

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from pydantic import BaseModel, Field

from deploy.drive.control_loop import Drive
from rover_ncp.core.geometry import Pose, distance
from rover_ncp.course.scoring import Parked

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


class Percentiles(BaseModel):
    """Percentiles of an error."""

    p50: float = Field(description="median")
    p95: float = Field(description="95th percentile")


class EstimateSummary(BaseModel):
    """The driver's estimates in many drives, against the truth."""

    error_m: Percentiles | None = Field(description="of the driver's estimate at the goal")
    predicted_error_m: Percentiles | None = Field(description="as deploy predicts it, without external poses")
    inside: dict[str, float | None] = Field(
        description="share of drives whose true position is inside the 50 % and the 95 % ellipse"
    )
    verdict_agrees: float = Field(
        description="share of drives of which the driver's verdict is parked or not parked, and true"
    )
    verdict_uncertain: float = Field(
        description="share of drives of which the driver's verdict is 'parked, uncertain'"
    )
    quiet_misses: float | None = Field(
        description="share of the verdicts parked that are false; null if there is none"
    )


def belief_of(drive: Drive, pose: Pose) -> Belief:
    """Return the belief of a driver whose rover ended at the true ``pose``."""
    error_m = squared = math.nan
    if drive.stop is None and drive.estimate is not None:
        estimate = drive.estimate
        error = np.array([estimate.pose.x - pose.x, estimate.pose.y - pose.y])
        error_m = distance(estimate.pose, pose)
        squared = float(error @ np.linalg.solve(estimate.covariance[:2, :2], error))
    predicted_m = math.nan if drive.predicted_error_m is None else drive.predicted_error_m
    verdict = None if drive.verdict is None else drive.verdict.words
    return Belief(verdict, error_m, squared, predicted_m)


def summary(beliefs: Sequence[Belief], parked: Sequence[bool]) -> EstimateSummary:
    """Return the estimates of drives that truly ended ``parked`` or not."""
    sure = np.array([belief.verdict is Parked.YES for belief in beliefs])
    denied = np.array([belief.verdict in {None, Parked.NO} for belief in beliefs])
    squared = np.array([belief.squared for belief in beliefs if math.isfinite(belief.squared)])
    return EstimateSummary(
        error_m=_percentiles([belief.error_m for belief in beliefs]),
        predicted_error_m=_percentiles([belief.predicted_m for belief in beliefs]),
        inside={
            f"{share:.0%}": float(np.mean(squared <= -2.0 * math.log(1.0 - share))) if len(squared) else None
            for share in ELLIPSES
        },
        verdict_agrees=float(np.mean(np.where(parked, sure, denied))),
        verdict_uncertain=float(np.mean([belief.verdict is Parked.UNCERTAIN for belief in beliefs])),
        quiet_misses=float(np.mean(~np.array(parked)[sure])) if sure.any() else None,
    )


def words(found: EstimateSummary) -> Iterator[str]:
    """Yield lines about a `summary`."""
    error, inside = found.error_m, found.inside
    if error is not None:
        yield (
            f"estimate against truth: median {1000 * error.p50:.0f}, 95th percentile "
            f"{1000 * error.p95:.0f} mm; inside its 50 % ellipse {inside['50%']:.0%}, "
            f"its 95 % ellipse {inside['95%']:.0%}"
        )
    if found.predicted_error_m is not None:
        predicted_mm = 1000 * found.predicted_error_m.p50
        yield f"predicted before the drive, without external poses: {predicted_mm:.0f} mm in 95 %"
    agrees, uncertain = found.verdict_agrees, found.verdict_uncertain
    yield f"the driver's own verdict is true: {agrees:.1%}, uncertain: {uncertain:.1%}"
    if found.quiet_misses is not None:
        yield f"not parked although the driver's verdict is parked: {found.quiet_misses:.1%} of these"


def _percentiles(values: Sequence[float]) -> Percentiles | None:
    known = [value for value in values if math.isfinite(value)]
    if not known:
        return None
    p50, p95 = np.percentile(known, [50, 95]).tolist()
    return Percentiles(p50=p50, p95=p95)
