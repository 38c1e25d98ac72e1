"""A course: checkpoints with deadlines, the start signal, obstacles, and the conditions for parked.

Poses are those of the base in the course's frame; times count from the run's start. The paper's course and
its reward are in section VI and the published simulator.
"""

import math
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Self

from pydantic import AfterValidator, Field, model_validator

from rover_ncp.core.config import StrictModel, load_yaml, validated
from rover_ncp.core.errors import ConfigError
from rover_ncp.core.files import resolve
from rover_ncp.core.geometry import Pose, distance, wrap_angle

TICK_S = 0.1
"""Control tick in seconds: the circuit computes ten commands a second."""

V_MAX = 0.16
"""Fastest reference in m/s: the paper's motors."""
OMEGA_MAX = 0.18
"""Fastest turn of a reference in rad/s: the paper's motors."""

MAX_CHECKPOINTS = 1000
"""Limit of checkpoints, and of obstacles: planning a course takes longer with each."""
MAX_HORIZON_S = 3600
MAX_MOVING_S = 180.0
"""Limit of a course's motion: it is planned in about half a minute."""
FAR_M = 1000.0
"""No rover gets farther within the longest horizon, an hour."""
SAME = 1e-6
"""Neighbours at most this far apart in m and rad are one pose, where the rover rests."""
_LAST_WAY, _STOPPING_S = 2.0, 2.0
"""The way to the goal takes at most so many times as long as at full speed, and this time to stop."""


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
    length: float = Field(ge=0.001, le=FAR_M, description="m, along theta")
    width: float = Field(ge=0.001, le=FAR_M, description="m")


class ParkedRule(StrictModel):
    """Conditions for a parked rover at the horizon's end."""

    position_m: float = Field(default=0.10, gt=0)
    heading_rad: float = Field(default=0.10, gt=0)
    still_s: float = Field(default=2.0, gt=0)
    still_m: float = Field(default=0.005, gt=0)
    still_rad: float = Field(default=0.005, gt=0)


class Course(StrictModel):
    """A manoeuvre to drive. Checkpoints are in the order of their deadlines."""

    format: int = Field(default=1, ge=1, le=1)
    name: Name
    description: str = ""
    start_signal_s: float = Field(ge=0, description="when the start signal goes from 0 to 1")
    horizon_s: float = Field(gt=0, le=MAX_HORIZON_S, description="how long the run lasts")
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
        if self.start_signal_s >= self.horizon_s:
            raise ValueError(
                f"the start signal ({self.start_signal_s} s) must come before the horizon "
                f"({self.horizon_s} s): without it the rover does not start"
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

    @property
    def timed_poses(self) -> list[tuple[float, Pose]]:
        """The start, at 0 s, and the checkpoints after it, each with its deadline in s."""
        found = [(point.t, point.pose) for point in self.checkpoints]
        return found if found[0][0] == 0 else [(0.0, Pose(0.0, 0.0, 0.0)), *found]

    @property
    def moving_s(self) -> float:
        """Time in which a reference moves, s: without the rests between equal poses and at the goal."""
        legs = [(end - begin, a, b) for (begin, a), (end, b) in pairwise(self.timed_poses)]
        seconds = [0.0 if same_pose(a, b) else duration for duration, a, b in legs]
        for _, a, b in legs[-1:]:
            seconds[-1] = min(seconds[-1], last_way_s(a, b, self.slower))
        return sum(seconds)

    def require_plannable(self, source: str = "") -> None:
        """Raise ConfigError, naming ``source``, for more motion than can be planned in reasonable time."""
        if self.moving_s > MAX_MOVING_S:
            raise ConfigError(
                source or f"course {self.name}",
                [
                    f"{self.moving_s:.0f} s of motion{self._slower_words}, expected at most "
                    f"{MAX_MOVING_S:.0f} s, for which a reference can be planned; divide the course"
                ],
            )

    @property
    def _slower_words(self) -> str:
        return f" ({self.slower:.2g} times the file's, for a slow robot)" if self.slower > 1.0 else ""

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


def load_course(name_or_path: str | Path) -> Course:
    """Load a shipped course by name or a course file by path. Raises FileError or ConfigError.

    A course that cannot be planned is refused for each policy, also for one that follows no reference.
    """
    path = resolve("courses", name_or_path)
    course = load_yaml(path, Course)
    course.require_plannable(str(path))
    return course


def same_pose(a: Pose, b: Pose) -> bool:
    """Return whether two neighbours are one pose, where the rover rests."""
    return max(abs(a.x - b.x), abs(a.y - b.y), abs(wrap_angle(a.theta - b.theta))) < SAME


def last_way_s(before: Pose, goal: Pose, slower: float) -> float:
    """Return how long the way from the last checkpoint before the goal takes at most, s."""
    turn = abs(wrap_angle(goal.theta - before.theta))
    way_s = slower * max(distance(before, goal) / V_MAX, turn / OMEGA_MAX)
    return _LAST_WAY * way_s + _STOPPING_S


def _times(part: StrictModel, factors: dict[str, float]) -> dict[str, float]:
    return {name: value * factors.get(name, 1.0) for name, value in part.model_dump().items()}
