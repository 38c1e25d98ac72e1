"""How a run on a course is judged: the reward at each checkpoint's deadline, and the verdict at its end."""

from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from rover_ncp.core.geometry import Pose, distance, wrap_angle
from rover_ncp.course.course import TICK_S, Course

SURE = 0.95
"""Least probability of a result that counts as certain."""
_SAMPLES = 20_000
"""Give a probability of 0.95 with a standard error of 0.0015."""


class Failure(StrEnum):
    """The first condition of a parked rover that a run missed, in the order of judgement."""

    NONE = ""
    TOUCHED = "touched an obstacle"
    EARLY = "ended early"
    FAR = "too far from the goal"
    TURNED = "too far from the goal's heading"
    MOVING = "still moving"


class Parked(StrEnum):
    """The words for the end of a run."""

    YES = "parked"
    UNCERTAIN = "parked, uncertain"
    """By an estimate whose covariance leaves more than 5 % for a rover that is not."""
    NO = "not parked"


@dataclass(frozen=True)
class Verdict:
    """Result of a run: errors to the last checkpoint, and the failure with a reason in numbers."""

    parked: bool
    """whether the rover parked"""
    error_m: float
    """final position error"""
    error_rad: float
    """final heading error"""
    reason: str = ""
    """why it did not park, or empty"""
    failure: Failure = Failure.NONE
    """the first condition that was missed, or empty"""
    probability: float | None = None
    """that the true pose is within the tolerances, by the estimate that was judged; null for a true pose"""

    @property
    def words(self) -> Parked:
        """The verdict in words."""
        if not self.parked:
            return Parked.NO
        return Parked.UNCERTAIN if self.probability is not None and self.probability < SURE else Parked.YES

    def with_contact(self, words: str) -> "Verdict":
        """Return the verdict of a rover whose base reported a contact; itself if ``words`` are empty."""
        if not words:
            return self
        touched = Failure.TOUCHED
        return replace(self, parked=False, reason=f"{touched}: {words}", failure=touched)


def judge(
    course: Course,
    times: list[float],
    poses: list[Pose],
    touched: bool,
    covariance: NDArray[np.float64] | None = None,
) -> Verdict:
    """Judge a run from its poses (course frame) at rising ``times`` in seconds.

    Parked means: at the end within the rule's distance and angle of the last checkpoint, still for the
    last ``still_s`` seconds, and never in contact with anything. ``covariance`` (3, 3) is that of the
    last pose, if the poses are estimates.
    """
    if not times or len(times) != len(poses):
        raise ValueError(f"need as many poses as times and at least one, got {len(poses)} and {len(times)}")
    rule, end = course.parked, poses[-1]
    error_m, error_rad = distance(end, course.goal), abs(wrap_angle(end.theta - course.goal.theta))
    tail = [p for t, p in zip(times, poses, strict=True) if t >= times[-1] - rule.still_s - 1e-9]
    moved = max(distance(end, p) for p in tail)
    turned = max(abs(wrap_angle(end.theta - p.theta)) for p in tail)
    failure, reason = Failure.NONE, ""
    if touched:
        failure = Failure.TOUCHED
        reason = failure.value
    elif times[-1] < course.horizon_s - TICK_S - 1e-9:
        failure = Failure.EARLY
        reason = f"ended early, at {times[-1]:.1f} s of {course.horizon_s:.1f} s"
    elif not error_m <= rule.position_m:
        failure = Failure.FAR
        reason = f"{error_m:.3f} m from the goal (at most {rule.position_m} m)"
    elif not error_rad <= rule.heading_rad:
        failure = Failure.TURNED
        reason = f"{error_rad:.3f} rad from the goal's heading (at most {rule.heading_rad} rad)"
    elif not (moved < rule.still_m and turned < rule.still_rad):
        failure = Failure.MOVING
        reason = f"still moving: {moved:.3f} m and {turned:.3f} rad in the last {rule.still_s} s"
    probability = None
    if covariance is not None:
        error = pose_error(end, course.goal)
        probability = probability_within(error, covariance, rule.position_m, rule.heading_rad)
    return Verdict(not failure, error_m, error_rad, reason, failure, probability)


def pose_error(pose: Pose, goal: Pose) -> Pose:
    """Return a pose minus a goal, in the axes of their frame."""
    return Pose(pose.x - goal.x, pose.y - goal.y, wrap_angle(pose.theta - goal.theta))


def probability_within(
    error: Pose, covariance: NDArray[np.float64], position_m: float, heading_rad: float
) -> float:
    """Return the probability that the true pose is within a distance and an angle of the goal.

    ``error`` is the estimate minus the goal, ``covariance`` (3, 3) that of its x, y and θ.
    """
    draws = pose_samples(error, covariance)
    near = np.hypot(draws[:, 0], draws[:, 1]) <= position_m
    return float(np.mean(near & (np.abs(draws[:, 2]) <= heading_rad)))


def pose_samples(mean: Pose, covariance: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return samples (20,000, 3) of a normal distribution of poses; the same arguments give the same ones."""
    return np.random.default_rng(0).multivariate_normal(mean, covariance, _SAMPLES, method="eigh")


def due_checkpoints(course: Course) -> NDArray[np.int64]:
    """Return (ticks,): the index of the checkpoint that is judged at the end of each tick, or -1.

    That is the next one whose deadline has come, at most one a tick. Tick k ends at 0.1 (k + 1) s; the
    tolerance keeps a deadline at a tick's end there whatever its last bit.
    """
    due = np.full(course.ticks, -1, np.int64)
    following = 0
    for tick in range(course.ticks):
        end_s = TICK_S * (tick + 1)
        if following < len(course.checkpoints) and course.checkpoints[following].t <= end_s + 1e-9:
            due[tick] = following
            following += 1
    return due


def reward(pose: Pose, checkpoint: Pose) -> float:
    """Return the paper's reward for ``pose`` at the deadline of ``checkpoint``: minus the squared miss.

    1 rad counts as 1 m.
    """
    dx, dy = pose.x - checkpoint.x, pose.y - checkpoint.y
    dtheta = wrap_angle(pose.theta - checkpoint.theta)
    return -(dx * dx + dy * dy + dtheta * dtheta)
