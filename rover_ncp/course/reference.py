"""The moving reference of a course: pose and motion that a rover should have at each tick.

The reference is a unicycle's drive, with v and ω linear between knots 0.5 s apart and within the motors'
limits, that fits the checkpoints best (least squares) and ends on the goal. It rests there, however late the
goal is due. It is drivable by construction; its deviations from the checkpoints show how far the course is
from drivable.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rover_ncp.core.geometry import Pose, Velocity, distance, wrap_angle
from rover_ncp.course.course import OMEGA_MAX, SAME, TICK_S, V_MAX, Course, last_way_s, same_pose

FloatArray = NDArray[np.float64]

COMMAND_MAX = Velocity(0.24, 0.36)
"""Fastest command of a circuit that follows a reference: it must be able to catch up."""

KNOT_TICKS = 5
"""Ticks between two knots of v and ω."""

_DECIMALS = 5
# Scales of the residuals: deviation from a checkpoint, and second difference of v and ω between knots.
_POSITION_M, _HEADING_RAD = 0.01, 0.02
_BEND_V, _BEND_OMEGA = 0.05, 0.10
_GOAL_WEIGHT = 20.0
_BACKWARD_M = 0.02
_MARGIN = 0.05
"""Distance of the fit's start from its bounds, as a share of them."""

_KNOTS_WITH_RESTS = 1200
"""Ten minutes. The matrices of longer courses have no rows for rests."""
_QUICK_S = 30.0
"""A course with less motion is planned in less than a second."""


class Deviation(NamedTuple):
    """How far the reference is from a checkpoint when it is due."""

    t: float
    error_m: float
    error_rad: float


@dataclass(frozen=True, eq=False)
class Reference:
    """One row for each tick of a course, its start included (T + 1): poses and motion there."""

    poses: FloatArray
    """(T + 1, 3): x and y in m, theta in rad, not wrapped."""
    motion: FloatArray
    """(T + 1, 2): v in m/s, negative backward, and omega in rad/s."""

    @property
    def ticks(self) -> int:
        """T, the number of ticks."""
        return len(self.poses) - 1

    def tick(self, k: int) -> tuple[Pose, Velocity]:
        """Return pose and motion at the start of tick ``k``; after the last tick, as at its end."""
        row = min(k, self.ticks)
        x, y, theta = self.poses[row].tolist()
        return Pose(x, y, wrap_angle(theta)), Velocity(*self.motion[row].tolist())

    def at(self, t: float) -> tuple[Pose, Velocity]:
        """Return pose and motion at ``t`` seconds, linear between ticks, at rest on the last pose after."""
        place = min(max(t / TICK_S, 0.0), float(self.ticks))
        k = min(int(place), self.ticks - 1)
        part = place - k
        x, y, theta = (1 - part) * self.poses[k] + part * self.poses[k + 1]
        v, omega = (1 - part) * self.motion[k] + part * self.motion[k + 1]
        return Pose(float(x), float(y), wrap_angle(float(theta))), Velocity(float(v), float(omega))


def drive_profile(start: Pose, v: Sequence[float], omega: Sequence[float]) -> Reference:
    """Drive speeds (T + 1,), linear between ticks, from ``start``: a reference drivable by construction."""
    poses = [tuple(start)]
    x, y, theta = start
    for k in range(len(v) - 1):
        mean_v, turn = 0.5 * (v[k] + v[k + 1]), 0.5 * TICK_S * (omega[k] + omega[k + 1])
        heading = theta + 0.5 * turn
        x += TICK_S * mean_v * math.cos(heading)
        y += TICK_S * mean_v * math.sin(heading)
        theta += turn
        poses.append((x, y, theta))
    return Reference(np.array(poses), np.column_stack([v, omega]).astype(np.float64))


def plan_reference(course: Course) -> Reference:
    """Return the reference of a course, which begins at its first checkpoint if that is due at 0 s.

    Otherwise it begins at the origin, as the rover does. It goes backward only where the course does. Raises
    ConfigError for a course with more than `MAX_MOVING_S` of motion.
    """
    course.require_plannable()
    v_max, omega_max = V_MAX / course.slower, OMEGA_MAX / course.slower
    # scipy takes half a second to import, and only policies that follow a reference need it.
    from scipy.optimize import least_squares

    fit = _Fit(course)
    poses = [fit.start, *(point.pose for point in course.checkpoints)]
    goes_backward = any(chord(a, b)[0] < -_BACKWARD_M for a, b in pairwise(poses))
    backward = v_max if goes_backward else 0.0
    v, omega = np.zeros(fit.knots), np.zeros(fit.knots)
    if fit.free.any():
        count = np.count_nonzero(fit.free)
        upper = np.repeat([v_max, omega_max], count)
        lower = np.repeat([-backward, -omega_max], count)
        # Strictly within the bounds, which a forward course's chords may lie on.
        margin = _MARGIN * upper
        begin = np.clip(fit.chords(), lower + margin, upper - margin)
        found = least_squares(
            fit.residuals, begin, fit.jacobian, bounds=(lower, upper), x_scale=upper, tr_solver="exact"
        )
        # Rounded, so that another machine's last bits do not show.
        v[fit.free], omega[fit.free] = np.round(found.x.reshape(2, count), _DECIMALS)
    return drive_profile(fit.start, _between(v), _between(omega))


def planning_notice(course: Course) -> str:
    """Return the line that announces a planning of more than about a second; "" for a shorter one."""
    if course.moving_s <= _QUICK_S:
        return ""
    return f"planning the reference of {course.name}: {course.moving_s:.0f} s of motion"


def deviations(course: Course, reference: Reference) -> list[Deviation]:
    """Return how far the reference is from each checkpoint at its deadline."""
    found = []
    for point in course.checkpoints:
        pose, _ = reference.at(point.t)
        found.append(
            Deviation(point.t, distance(pose, point.pose), abs(wrap_angle(pose.theta - point.theta)))
        )
    return found


def chord(a: Pose, b: Pose) -> tuple[float, float, float]:
    """Return how far ``b`` is from ``a`` along and across the mean of their headings, and the turn.

    In m, to the left, and rad. An arc has no distance across.
    """
    turn = wrap_angle(b.theta - a.theta)
    heading = a.theta + 0.5 * turn
    cos, sin = math.cos(heading), math.sin(heading)
    dx, dy = b.x - a.x, b.y - a.y
    return dx * cos + dy * sin, dy * cos - dx * sin, turn


class _Fit:
    """The least-squares problem: unknowns are v, then ω, at the knots where the course does not rest."""

    def __init__(self, course: Course) -> None:
        points = course.checkpoints
        self._points = course.timed_poses
        self.start = self._points[0][1]
        self.knots = -(-course.ticks // KNOT_TICKS) + 1
        self.free = _moving(self._points, self.knots, course.slower)
        headings = np.unwrap([self.start.theta, *(point.theta for point in points)])[1:]
        self._targets = np.array([[point.x for point in points], [point.y for point in points], headings])
        at_goal = np.abs(self._targets - self._targets[:, -1:]).max(axis=0) < SAME
        self._scale = np.array([[_POSITION_M], [_POSITION_M], [_HEADING_RAD]]) / np.where(
            at_goal, _GOAL_WEIGHT, 1.0
        )
        # Ticks and bends at rest are left out, so that long rests take little time and memory. The last bits
        # of the fit depend on the number of bends: shorter courses keep all, as in earlier versions.
        free, column = self.free, np.where(self.free, np.cumsum(self.free) - 1, -1)
        moving = np.repeat(free[1:] | free[:-1], KNOT_TICKS)[: course.ticks]
        driven = np.concatenate([[0], np.cumsum(moving)])
        self._due = _hat(np.array([point.t for point in points]) / TICK_S, driven)
        ticks = np.flatnonzero(moving)
        # At the middle of each moving tick, as a mean of the unknowns.
        self._mean = 0.5 * (_hat((ticks + 1) / KNOT_TICKS, column) + _hat(ticks / KNOT_TICKS, column))
        bends = np.arange(self.knots - 2)
        if self.knots > _KNOTS_WITH_RESTS:
            bends = np.flatnonzero(free[2:] | free[1:-1] | free[:-2])
        self._bend = _second_differences(bends, column)

    def chords(self) -> FloatArray:
        """Return the unknowns of a drive along the chords between checkpoints."""
        times = TICK_S * KNOT_TICKS * np.arange(self.knots)[self.free]
        middles, v, omega = [], [], []
        for (t_a, a), (t_b, b) in pairwise(self._points):
            ahead, _, turn = chord(a, b)
            middles.append(0.5 * (t_a + t_b))
            v.append(ahead / (t_b - t_a))
            omega.append(turn / (t_b - t_a))
        return np.concatenate([np.interp(times, middles, v), np.interp(times, middles, omega)])

    def _drive(self, unknowns: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the step lengths (T,), the headings in the middle (T,) and at the ticks (T + 1,).

        T is the number of moving ticks.
        """
        v, omega = unknowns.reshape(2, -1)
        theta = self.start.theta + TICK_S * _sums((self._mean @ omega)[:, None])[:, 0]
        return TICK_S * (self._mean @ v), 0.5 * (theta[1:] + theta[:-1]), theta

    def residuals(self, unknowns: FloatArray) -> FloatArray:
        step, heading, theta = self._drive(unknowns)
        path = _sums(np.column_stack([step * np.cos(heading), step * np.sin(heading)]))
        reached = self._due @ np.column_stack([path + self.start[:2], theta])
        v, omega = unknowns.reshape(2, -1)
        residuals = (reached.T - self._targets) / self._scale
        return np.concatenate([residuals.ravel(), self._bend @ v / _BEND_V, self._bend @ omega / _BEND_OMEGA])

    def jacobian(self, unknowns: FloatArray) -> FloatArray:
        step, heading, _ = self._drive(unknowns)
        step, cos, sin = step[:, None], np.cos(heading)[:, None], np.sin(heading)[:, None]
        turned = TICK_S * _sums(self._mean)
        between = 0.5 * (turned[1:] + turned[:-1])
        by_v = (_sums(TICK_S * cos * self._mean), _sums(TICK_S * sin * self._mean), 0.0 * turned)
        by_omega = (_sums(-step * sin * between), _sums(step * cos * between), turned)
        rows = [
            self._due @ np.hstack([v, omega]) / scale[:, None]
            for v, omega, scale in zip(by_v, by_omega, self._scale, strict=True)
        ]
        none = np.zeros_like(self._bend)
        rows += [np.hstack([self._bend / _BEND_V, none]), np.hstack([none, self._bend / _BEND_OMEGA])]
        return np.vstack(rows)


def _moving(points: Sequence[tuple[float, Pose]], knots: int, slower: float) -> NDArray[np.bool_]:
    """Return (knots,) where the reference moves: not between equal points, nor when it can be at the goal.

    A goal is often due at the horizon: a fit that may move until then turns slowly to and fro. ``points`` are
    the start and the checkpoints after it, each with its deadline.
    """
    times, (due, goal) = TICK_S * KNOT_TICKS * np.arange(knots), points[-1]
    free = times < due
    free[0] = False
    for begin, before in points[-2:-1]:
        free &= times <= begin + last_way_s(before, goal, slower)
    for (begin, a), (end, b) in pairwise(points):
        if same_pose(a, b):
            free &= (times < begin) | (times > end)
    return free


def _between(knots: FloatArray) -> list[float]:
    """Return the values at ticks from those at knots, one after the other: no library's order of sums."""
    values = []
    for a, b in pairwise(knots.tolist()):
        values += [a + (b - a) * i / KNOT_TICKS for i in range(KNOT_TICKS)]
    return [*values, float(knots[-1])]


def _sums(rows: FloatArray) -> FloatArray:
    """Return the sums (T + 1, ...) of the first 0, 1, 2, ... rows."""
    return np.vstack([np.zeros((1, rows.shape[1])), np.cumsum(rows, axis=0)])


def _hat(places: FloatArray, column: NDArray[np.int64]) -> FloatArray:
    """Return the matrix (places, columns) that interpolates linearly between whole numbers.

    The value at whole number i is in column ``column[i]``; -1 is a value of 0.
    """
    places = np.minimum(places, len(column) - 1)
    below = np.minimum(places.astype(int), len(column) - 2)
    above = places - below
    return _matrix((column[below], column[below + 1]), (1 - above, above), column)


def _second_differences(knots: NDArray[np.int64], column: NDArray[np.int64]) -> FloatArray:
    """Return the matrix (knots, columns) of second differences from ``knots`` on; ``column`` as in `_hat`."""
    return _matrix([column[knots + i] for i in range(3)], (1.0, -2.0, 1.0), column)


def _matrix(
    places: Sequence[NDArray[np.int64]], weights: Sequence[FloatArray | float], column: NDArray[np.int64]
) -> FloatArray:
    """Return the matrix that has in each row the ``weights`` at the columns ``places``; -1 is no column."""
    rows = np.arange(len(places[0]))
    matrix = np.zeros((len(rows), int(column.max()) + 2), order="F")
    for place, weight in zip(places, weights, strict=True):
        matrix[rows, place] += weight
    return matrix[:, :-1]
