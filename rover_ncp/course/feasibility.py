"""Whether a course can be driven, and if not, where and why.

The reference of a drivable course starts at the rover's start, passes every checkpoint within the tolerance
for parked (at the goal within a quarter of it), rests there long enough, and touches no obstacle.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum
from itertools import pairwise

import numpy as np

from rover_ncp.core.config import ResultModel
from rover_ncp.core.files import DEFAULT_ROBOT
from rover_ncp.core.geometry import Pose, distance, wrap_angle
from rover_ncp.course.course import OMEGA_MAX, TICK_S, V_MAX, Checkpoint, Course, Obstacle
from rover_ncp.course.reference import Deviation, FloatArray, Reference, chord, deviations, plan_reference
from rover_ncp.robot.description import RobotDescription, load_description

GOAL_SHARE = 0.25
SIDEWAYS = 0.5
"""A step of more than this across, as a share of the step along, is sideways and not a bend."""
SIDEWAYS_M = 0.02
_UNIT = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) / 2


class Cause(StrEnum):
    """Reason why a checkpoint cannot be reached."""

    FAST = "too fast"
    TURN = "turns too fast"
    SIDEWAYS = "sideways"
    BEND = "too sharp a bend"
    OBSTACLE = "obstacle"
    START = "start"
    REST = "no rest"


@dataclass(frozen=True)
class Problem:
    """A checkpoint that cannot be reached."""

    checkpoint: int
    """counted from 1"""
    t: float
    """time on the course in s"""
    cause: Cause
    """what makes it undrivable"""
    detail: str
    """in words"""

    def __str__(self) -> str:
        return f"checkpoint {self.checkpoint} ({self.t:g} s): {self.cause.value}: {self.detail}"


@dataclass(frozen=True)
class Drivability:
    """Result of the check; ``deviations`` has one entry for each checkpoint."""

    reference: Reference
    deviations: tuple[Deviation, ...]
    problems: tuple[Problem, ...]
    clearance_m: float | None
    """Smallest distance between the rover and an obstacle, 0 if they touch; None without obstacles."""

    @property
    def drivable(self) -> bool:
        """Whether there is no problem."""
        return not self.problems


class CourseResult(ResultModel):
    """What ``rover-ncp course`` prints."""

    course: str
    """its name"""
    drivable: bool
    """whether there is no problem"""
    problems: tuple[Problem, ...]
    """times count in the course, checkpoints from 1"""
    checkpoints: int
    """how many"""
    horizon_s: float
    """how long the course lasts"""
    worst_miss_m: float
    """of the nearest drive, at the checkpoints"""
    worst_miss_rad: float
    """largest difference of heading at a checkpoint"""
    clearance_m: float | None
    """null without obstacles"""
    scaled: tuple[str, ...]
    """the line on a course that takes longer for --model"""
    out: str | None
    """the file that was written"""


def check_course(
    course: Course,
    robot: RobotDescription | None = None,
    reference: Reference | None = None,
    *,
    clearance: bool = True,
) -> Drivability:
    """Check a course for the outline of ``robot``; None is a Pioneer 3-AT.

    Its ``reference`` is planned, from the origin, or given, from where the rover stands. The ``clearance``
    takes most of the time and does not decide.
    """
    robot = load_description(DEFAULT_ROBOT) if robot is None else robot
    problems = _start(course) if reference is None else []
    reference = plan_reference(course) if reference is None else reference
    found = tuple(deviations(course, reference))
    problems += [*_missed(course, found), *_rest(course, reference)]
    least, touching = _clearance(course, reference, robot, clearance)
    problems += touching
    problems.sort(key=lambda problem: (problem.t, problem.checkpoint))
    return Drivability(reference, found, tuple(problems), least)


def clearance_at(pose: Pose, obstacles: Iterable[Obstacle], robot: RobotDescription) -> float:
    """Return the distance (m) from a robot to the nearest obstacle: 0 if it touches one, infinite without."""
    rover = _placed(_outline(robot), list(pose))
    return min((_gap(rover, _corners(obstacle)) for obstacle in obstacles), default=math.inf)


def _start(course: Course) -> list[Problem]:
    first, rule = course.checkpoints[0], course.parked
    away, turned = distance(first.pose, Pose(0, 0, 0)), abs(wrap_angle(first.theta))
    if first.t > 0 or (away <= rule.position_m and turned <= rule.heading_rad):
        return []
    detail = f"it is {away:.2f} m and {turned:.2f} rad from the origin, where the rover starts"
    return [Problem(1, 0.0, Cause.START, detail)]


def _missed(course: Course, found: tuple[Deviation, ...]) -> list[Problem]:
    rule, last = course.parked, len(found)
    demands = _demands(course)
    problems = []
    for number, miss in enumerate(found, 1):
        share = GOAL_SHARE if number == last else 1.0
        if miss.error_m <= share * rule.position_m and miss.error_rad <= share * rule.heading_rad:
            continue
        missed = f"missed by {miss.error_m:.2f} m and {miss.error_rad:.2f} rad"
        cause, why = Cause.BEND, "the motors cannot follow the way there"
        if demands:
            # An excessive demand shows at its neighbours, too: the fit spreads the deviations.
            into, cause, why = min(demands, key=lambda demand: abs(demand[0] - number))
            why += "" if into == number else f" into checkpoint {into}"
        problems.append(Problem(number, miss.t, cause, f"{why}; {missed}"))
    return problems


def _demands(course: Course) -> list[tuple[int, Cause, str]]:
    """Return the checkpoints that the motors cannot reach in time from the previous one."""
    found = []
    v_max, omega_max = V_MAX / course.slower, OMEGA_MAX / course.slower
    points = list(course.checkpoints)
    if points[0].t > 0:
        points.insert(0, Checkpoint(t=0.0, x=0.0, y=0.0, theta=0.0))
    skipped = len(points) - len(course.checkpoints)
    for number, (a, b) in enumerate(pairwise(points), 2 - skipped):
        ahead, left, turn = chord(a.pose, b.pose)
        seconds = b.t - a.t
        speed, rate = math.hypot(ahead, left) / seconds, abs(turn) / seconds
        if speed > v_max:
            found.append((number, Cause.FAST, f"{speed:.2f} m/s (at most {v_max:.3g} m/s)"))
        elif abs(left) > SIDEWAYS_M and abs(left) > SIDEWAYS * abs(ahead):
            side = "left" if left > 0 else "right"
            found.append(
                (number, Cause.SIDEWAYS, f"{abs(left):.2f} m to the {side}, {abs(ahead):.2f} m along")
            )
        elif rate > omega_max:
            found.append((number, Cause.TURN, f"{rate:.2f} rad/s (at most {omega_max:.3g} rad/s)"))
    return found


def _rest(course: Course, reference: Reference) -> list[Problem]:
    rule, ticks = course.parked, round(course.parked.still_s / TICK_S)
    tail = reference.poses[-ticks - 1 :]
    moved = float(np.hypot(*(tail[:, :2] - tail[-1, :2]).T).max())
    turned = float(np.abs(tail[:, 2] - tail[-1, 2]).max())
    if moved < rule.still_m and turned < rule.still_rad:
        return []
    detail = f"{moved:.3f} m and {turned:.3f} rad in the last {rule.still_s:g} s; let the goal be due earlier"
    return [Problem(len(course.checkpoints), course.checkpoints[-1].t, Cause.REST, detail)]


def _clearance(
    course: Course, reference: Reference, robot: RobotDescription, measure: bool
) -> tuple[float | None, list[Problem]]:
    """Return the least clearance if it is to be measured, and the first touch of each obstacle."""
    if not course.obstacles:
        return None, []
    least, problems = math.inf, []
    rover = _outline(robot)
    size = f"{robot.length_m:g} m by {robot.width_m:g} m"
    reach, poses = float(np.hypot(*rover.T).max()), reference.poses.tolist()
    for which, obstacle in enumerate(course.obstacles, 1):
        corners = _corners(obstacle)
        away = (reference.poses[:, :2] - [obstacle.x, obstacle.y]) @ _turn(-obstacle.theta)
        beyond = np.maximum(np.abs(away) - [obstacle.length / 2, obstacle.width / 2], 0.0)
        # No gap is smaller than this: most poses are too far away to matter, also those beside a long wall.
        bounds = np.hypot(*beyond.T) - reach
        for k in np.argsort(bounds).tolist() if measure else ():
            if bounds[k] >= least:
                break
            least = min(least, _gap(_placed(rover, poses[k]), corners))
        near = np.flatnonzero(bounds <= 0.0).tolist()
        touching = next((k for k in near if _gap(_placed(rover, poses[k]), corners) <= 0.0), None)
        if touching is not None:
            t = touching * TICK_S
            number = next(
                (n for n, p in enumerate(course.checkpoints, 1) if p.t >= t - 1e-9), len(course.checkpoints)
            )
            detail = f"the rover ({size}) touches obstacle {which} at {t:.1f} s"
            problems.append(Problem(number, course.checkpoints[number - 1].t, Cause.OBSTACLE, detail))
    return max(least, 0.0) if measure else None, problems


def _outline(robot: RobotDescription) -> FloatArray:
    # From its centre of rotation, which need not be its middle.
    return _UNIT * [robot.length_m, robot.width_m] + [(robot.front_m - robot.rear_m) / 2, 0.0]


def _corners(obstacle: Obstacle) -> FloatArray:
    return _placed(_UNIT * [obstacle.length, obstacle.width], [obstacle.x, obstacle.y, obstacle.theta])


def _placed(corners: FloatArray, pose: list[float]) -> FloatArray:
    placed: FloatArray = corners @ _turn(pose[2]) + np.array(pose[:2])
    return placed


def _turn(angle: float) -> FloatArray:
    """Return the matrix that turns rows (k, 2) by an angle."""
    cos, sin = math.cos(angle), math.sin(angle)
    return np.array([[cos, sin], [-sin, cos]])


def _gap(a: FloatArray, b: FloatArray) -> float:
    """Return the distance between two convex shapes, (k, 2) corners counter-clockwise; 0 if they meet."""
    apart = False
    for one, other in ((a, b), (b, a)):
        edges = np.roll(one, -1, axis=0) - one
        outward = np.column_stack([edges[:, 1], -edges[:, 0]])
        beyond = np.einsum("ij,kij->ik", outward, other[:, None] - one[None])
        apart |= bool((beyond.min(axis=1) > 0).any())
    return min(_to_edges(a, b), _to_edges(b, a)) if apart else 0.0


def _to_edges(corners: FloatArray, shape: FloatArray) -> float:
    """Return the least distance from corners to the edges of a shape."""
    edges = np.roll(shape, -1, axis=0) - shape
    away = corners[:, None] - shape[None]
    along = np.clip((away * edges).sum(axis=2) / (edges * edges).sum(axis=1), 0.0, 1.0)
    return float(np.hypot(*(away - along[:, :, None] * edges).transpose(2, 0, 1)).min())
