"""A course: checkpoints with deadlines, the start signal, obstacles, and the conditions for parked.

Poses are those of the base in the course's frame; times count from the run's start. The paper's course and
its reward are in section VI and the published simulator.
"""

import math
from dataclasses import dataclass, replace
from enum import StrEnum
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, Field, model_validator

from rover_ncp.core.config import StrictModel, load_yaml, validated
from rover_ncp.core.files import resolve
from rover_ncp.core.geometry import Pose, distance, wrap_angle

TICK_S = 0.1
"""Control tick in seconds: the circuit computes ten commands a second."""

MAX_CHECKPOINTS = 1000
"""Limit of checkpoints, and of obstacles: planning a course takes longer with each."""
FAR_M = 1000.0
"""No rover gets farther within the longest horizon, an hour."""
SURE = 0.95
"""Least probability of a result that counts as certain."""
_SAMPLES = 20_000
"""Give a probability of 0.95 with a standard error of 0.0015."""


def _radians(angle: float) -> float:
    if abs(angle) > 2 * math.pi:
        raise ValueError("an angle is in radians, from -2π to 2π")
    return angle


Coordinate = Annotated[float, Field(ge=-FAR_M, le=FAR_M, description="m")]
Angle = Annotated[float, AfterValidator(_radians), Field(description="rad, left positive, -2π to 2π")]
Name = Annotated[str, Field(pattern=r"^[a-z0-9][a-z0-9_-]*$", max_length=64)]


class Checkpoint(StrictModel):
    """Pose that the base should have at a deadline: t in s, x and y in m, theta in rad."""

    t: float = Field(ge=0, description="s")
    x: Coordinate
    y: Coordinate
    theta: Angle

    @property
    def pose(self) -> Pose:
        """The checkpoint without its deadline."""
        return Pose(self.x, self.y, self.theta)


class Obstacle(StrictModel):
    """A rectangle that cannot be pushed: its centre and heading, its length and width in metres."""

    x: Coordinate
    y: Coordinate
    theta: Angle = 0.0
    length: float = Field(gt=0, le=FAR_M, description="m, along theta")
    width: float = Field(gt=0, le=FAR_M, description="m")


class ParkedRule(StrictModel):
    """Conditions for a parked rover at the horizon's end."""

    position_m: float = Field(default=0.10, gt=0)
    heading_rad: float = Field(default=0.10, gt=0)
    still_s: float = Field(default=2.0, gt=0)
    still_m: float = Field(default=0.005, gt=0)
    still_rad: float = Field(default=0.005, gt=0)


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


class Course(StrictModel):
    """A manoeuvre to drive. Checkpoints are in the order of their deadlines."""

    format: int = Field(default=1, ge=1, le=1)
    name: Name
    description: str = ""
    start_signal_s: float = Field(ge=0, description="when the start signal goes from 0 to 1")
    horizon_s: float = Field(gt=0, le=3600, description="how long the run lasts")
    checkpoints: tuple[Checkpoint, ...] = Field(min_length=1, max_length=MAX_CHECKPOINTS)
    obstacles: tuple[Obstacle, ...] = Field(default=(), max_length=MAX_CHECKPOINTS)
    parked: ParkedRule = ParkedRule()
    slower: float = Field(
        default=1.0,
        ge=1,
        exclude_if=lambda factor: factor == 1.0,
        description="the fastest speed and turn of the reference are divided by this",
    )

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        times = [point.t for point in self.checkpoints]
        if any(b <= a for a, b in pairwise(times)):
            raise ValueError("checkpoints must have rising deadlines")
        if times[-1] > self.horizon_s:
            raise ValueError(
                f"the last deadline ({times[-1]} s) lies behind the horizon ({self.horizon_s} s)"
            )
        if abs(self.ticks * TICK_S - self.horizon_s) > 1e-9:
            raise ValueError(
                f"the horizon must be a whole number of {TICK_S} s ticks, got {self.horizon_s} s"
            )
        return self

    @property
    def ticks(self) -> int:
        """Number of control ticks to the horizon."""
        return round(self.horizon_s / TICK_S)

    @property
    def goal(self) -> Pose:
        """The last checkpoint."""
        return self.checkpoints[-1].pose

    def scaled(self, size: float, slower: float) -> "Course":
        """Scale the course in space by ``size`` and in speed by 1 / ``slower``.

        The conditions for parked stay. Raises ConfigError if the course would take more than an hour.
        """
        time = size * slower
        places = {"x": size, "y": size}
        changed = {
            "slower": self.slower * slower,
            "start_signal_s": self.start_signal_s * time,
            "horizon_s": math.ceil(self.horizon_s * time / TICK_S - 1e-9) * TICK_S,
            "checkpoints": [_times(point, places | {"t": time}) for point in self.checkpoints],
            "obstacles": [_times(each, places | {"length": size, "width": size}) for each in self.obstacles],
        }
        source = f"course {self.name}, {size:g} times as large, {time:g} times as long"
        return validated(self.model_dump() | changed, Course, source)

    def start_signal(self, t: float) -> float:
        """Return the start signal at ``t`` seconds: 0 before its time, 1 from then on.

        A tick's time is a sum of tenths; the tolerance keeps tick 30 at 3.0 s whatever its last bit.
        """
        return 1.0 if t >= self.start_signal_s - 1e-9 else 0.0

    def judge(
        self,
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
            raise ValueError(
                f"need as many poses as times and at least one, got {len(poses)} and {len(times)}"
            )
        rule, end = self.parked, poses[-1]
        error_m, error_rad = distance(end, self.goal), abs(wrap_angle(end.theta - self.goal.theta))
        tail = [p for t, p in zip(times, poses, strict=True) if t >= times[-1] - rule.still_s - 1e-9]
        moved = max(distance(end, p) for p in tail)
        turned = max(abs(wrap_angle(end.theta - p.theta)) for p in tail)
        failure, reason = Failure.NONE, ""
        if touched:
            failure = Failure.TOUCHED
            reason = failure.value
        elif times[-1] < self.horizon_s - TICK_S - 1e-9:
            failure = Failure.EARLY
            reason = f"ended early, at {times[-1]:.1f} s of {self.horizon_s:.1f} s"
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
            error = Pose(end.x - self.goal.x, end.y - self.goal.y, wrap_angle(end.theta - self.goal.theta))
            probability = probability_within(error, covariance, rule.position_m, rule.heading_rad)
        return Verdict(not failure, error_m, error_rad, reason, failure, probability)


def probability_within(
    error: Pose, covariance: NDArray[np.float64], position_m: float, heading_rad: float
) -> float:
    """Return the probability that the true pose is within a distance and an angle of the goal.

    ``error`` is the estimate minus the goal, ``covariance`` (3, 3) that of its x, y and θ. The same
    arguments give the same result: the samples of the normal distribution have a fixed seed.
    """
    draws = np.random.default_rng(0).multivariate_normal(error, covariance, _SAMPLES, method="eigh")
    near = np.hypot(draws[:, 0], draws[:, 1]) <= position_m
    return float(np.mean(near & (np.abs(draws[:, 2]) <= heading_rad)))


def load_course(name_or_path: str | Path) -> Course:
    """Load a shipped course by name or a course file by path. Raises FileError or ConfigError."""
    return load_yaml(resolve("courses", name_or_path), Course)


def _times(part: StrictModel, factors: dict[str, float]) -> dict[str, float]:
    return {name: value * factors.get(name, 1.0) for name, value in part.model_dump().items()}


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
