"""The driver's estimate at the end of a stack simulation against the truth, over many trials."""

import math
from collections import Counter
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
    probability: float | None
    """That the rover is within the tolerances, by the driver's estimate; None as for the verdict."""
    error_m: float
    """Position error of the estimate; NaN if a safety rule stopped the drive."""
    squared: float
    """Squared error, normalised by the estimate's covariance: χ² with 2 degrees of freedom."""


class Percentiles(BaseModel):
    """Percentiles of an error."""

    p50: float = Field(description="median")
    p95: float = Field(description="95th percentile")


class EstimateSummary(BaseModel):
    """The driver's estimates in many drives, against the truth."""

    error_m: Percentiles | None = Field(description="of the driver's estimate at the goal")
    inside: dict[str, float | None] = Field(
        description="share of drives whose true position is inside the 50 % and the 95 % ellipse"
    )
    verdicts: dict[str, int] = Field(
        description="number of drives by the driver's verdict; 'stopped' by a safety rule"
    )
    verdict_agrees: float | None = Field(
        description="share of the verdicts that are true, without the uncertain ones; null if there is none"
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
    verdict = None if drive.verdict is None else drive.verdict.words
    probability = None if drive.verdict is None else drive.verdict.probability
    return Belief(verdict, probability, error_m, squared)


def summary(beliefs: Sequence[Belief], parked: Sequence[bool]) -> EstimateSummary:
    """Return the estimates of drives that truly ended ``parked`` or not."""
    sure = np.array([belief.verdict is Parked.YES for belief in beliefs])
    certain = np.array([belief.verdict is not Parked.UNCERTAIN for belief in beliefs])
    verdicts = Counter("stopped" if belief.verdict is None else belief.verdict.value for belief in beliefs)
    squared = np.array([belief.squared for belief in beliefs if math.isfinite(belief.squared)])
    return EstimateSummary(
        error_m=_percentiles([belief.error_m for belief in beliefs]),
        inside={
            f"{share:.0%}": float(np.mean(squared <= -2.0 * math.log(1.0 - share))) if len(squared) else None
            for share in ELLIPSES
        },
        verdicts=dict(verdicts.most_common()),
        verdict_agrees=float(np.mean((sure == parked)[certain])) if certain.any() else None,
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
    counts = ", ".join(f"{verdict}: {count}" for verdict, count in found.verdicts.items())
    agrees = (
        "" if found.verdict_agrees is None else f"; {found.verdict_agrees:.1%} of the certain ones are true"
    )
    yield f"the driver's own verdicts: {counts}{agrees}"
    if found.quiet_misses is not None:
        yield f"not parked although the driver's verdict is parked: {found.quiet_misses:.1%} of these"


def _percentiles(values: Sequence[float]) -> Percentiles | None:
    known = [value for value in values if math.isfinite(value)]
    if not known:
        return None
    p50, p95 = np.percentile(known, [50, 95]).tolist()
    return Percentiles(p50=p50, p95=p95)
