"""Verdicts of a docking: evidence, estimate and poses in, verdict out. No state, no I/O, no clock."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from deploy.drive.start import median_pose
from deploy.estimator.estimator import Estimate
from deploy.place.outcome import DockError, Evidence, PoseErrors
from deploy.place.place import Place, Proof
from rover_ncp.core.geometry import Pose, distance, near, wrap_angle
from rover_ncp.course.scoring import Failure, Parked, Verdict, pose_error, probability_within

STAGED_M, STAGED_RAD = 0.10, math.radians(10.0)
"""How far from the staging pose an approach may begin: the policy's training."""
DOCK_M, DOCK_RAD = 0.10, math.radians(10.0)
"""How far from the place a report counts: farther away it is of another dock."""
REPORT_S = 25.0
"""How long a rover waits for the report that proves a docking; some robots send it each 10 s or later."""
LATE_S = 35.0
"""How much longer where the last report, which is older, says that it is docked."""
MIN_POSES = 3
"""External poses that a median needs."""

_NO_PROOF = {
    (Proof.CHARGING, None): (
        DockError.FAILED_TO_CHARGE,
        "battery_state does not tell whether the battery charges: unknown, or full",
    ),
    (Proof.CHARGING, False): (DockError.FAILED_TO_CHARGE, f"no charge within {REPORT_S:g} s"),
    (Proof.CHARGING, True): (DockError.FAILED_TO_CHARGE, "no new battery_state"),
    (Proof.TOPIC, None): (
        DockError.FAILED_TO_CONTROL,
        "no message on 'docked': the bridge's description must name topics.docked, and the robot send it",
    ),
    (Proof.TOPIC, False): (
        DockError.FAILED_TO_CONTROL,
        f"within {REPORT_S:g} s the robot's topic did not say that it is docked",
    ),
    (Proof.TOPIC, True): (
        DockError.FAILED_TO_CONTROL,
        "the robot's topic said that it is docked only before the end of the approach",
    ),
}
"""Error and words of a docking without its proof, by proof and by what the newest report says."""


class Judgement(NamedTuple):
    """How a docking is judged."""

    error: DockError = DockError.NONE
    why: str = ""
    """Why it is not docked, in words."""
    gives_up: bool = False
    """Whether no further try can succeed."""


class Approached(NamedTuple):
    """The end of an approach, as in `DockResult`."""

    probability: float | None = None
    by_estimate: PoseErrors | None = None
    by_proof: PoseErrors | None = None


def approached(place: Place, pose: Pose, probability: float | None, poses: Sequence[Pose]) -> Approached:
    """Return the errors at the end of an approach, by the estimate and by the newest external poses."""
    by_poses = place.errors(median_pose(poses)) if len(poses) >= MIN_POSES else None
    return Approached(probability, place.errors(pose), by_poses)


def judge_approach(
    place: Place, pose: Pose, verdict: Verdict, end: Approached, contact: bool
) -> Judgement | None:
    """Judge the end of an approach at the estimate ``pose``; None if a report has to prove it.

    ``verdict`` is that of the approach as a course.
    """
    where = f"{end.by_estimate} of the place by the estimate"
    by_pose, far = place.proof is Proof.POSE, not near(pose, place.goal, DOCK_M, DOCK_RAD)
    why = ""
    if contact and (by_pose or far):
        why = f"contact {where}"
    elif not by_pose and far:
        why = f"too far for the place's dock, {where}"
    elif not by_pose:
        return None
    elif end.by_proof is not None and not place.allows(end.by_proof):
        why = f"{end.by_proof} of the place by the external poses alone, {where}"
    elif verdict.words is not Parked.YES:
        why = verdict.reason or f"within the tolerances with a probability of {verdict.probability:.0%}"
    return Judgement(DockError.FAILED_TO_CONTROL, why) if why else Judgement()


def judge_report(
    proof: Proof, evidence: Evidence, known_reports: int, t: float, began: float
) -> Judgement | None:
    """Judge at time ``t`` a rover that waits since ``began`` for the report that proves its docking.

    Returns None while it has to wait. The ``known_reports`` from before do not count: they may be of another
    place.
    """
    _, docked, reports = evidence
    if docked and reports > known_reports:
        return Judgement()
    if t < began + REPORT_S + (LATE_S if docked else 0.0):
        return None
    return Judgement(*_NO_PROOF[proof, docked], gives_up=docked is None)


def judge_drive(
    place: Place, undock: bool, estimate: Estimate, taught: NDArray[np.float64], judgement: Judgement
) -> Verdict:
    """Return the verdict of a drive; parked means docked, or undocked and at the staging pose.

    ``taught`` (3, 3) is the covariance of the place.
    """
    goal, pose = place.staging if undock else place.goal, estimate.pose
    error_m, error_rad = distance(pose, goal), abs(wrap_angle(pose.theta - goal.theta))
    failure, sure = Failure.NONE if judgement.error is DockError.NONE else Failure.FAR, None
    if undock:
        error, covariance = pose_error(pose, goal), estimate.covariance[:3, :3] + taught
        sure = probability_within(error, covariance, STAGED_M, STAGED_RAD)
    return Verdict(failure is Failure.NONE, error_m, error_rad, judgement.why, failure, sure)
