"""Plans of a docking: the ways to the staging pose, into the place and back out, each with its reference.

A way is a sequence of straight pieces and turns on the spot, each from rest to rest, so that its reference
is drivable by construction. The rover drives each way with one end ahead: with its front, or backward with
its tail.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

from deploy.drive.config import BLIND_S
from deploy.place.place import AT_PLACE_M, Place
from deploy.place.room import Fit, Room
from deploy.place.sight import Blind, Sight, blind
from rover_ncp.core.errors import UsageError
from rover_ncp.core.files import DEFAULT_ROBOT
from rover_ncp.core.geometry import Pose, compose, distance, turned, wrap_angle
from rover_ncp.course.course import (
    MAX_CHECKPOINTS,
    MAX_HORIZON_S,
    OMEGA_MAX,
    TICK_S,
    V_MAX,
    Checkpoint,
    Course,
    ParkedRule,
)
from rover_ncp.course.feasibility import Problem, check_course, clearance_at
from rover_ncp.course.reference import Reference, drive_profile
from rover_ncp.robot.description import RobotDescription, load_description

EASE = 0.6
"""Speed of a plan, as a share of the limits of a reference: the policy must be able to catch up."""
BACK_TURN_RAD_S = 0.75 * OMEGA_MAX
"""Rate of a first turn the longer way round: the rover loses the tags for as long as it takes."""
SURE_S = 0.75 * BLIND_S
"""Ways that lose the tags for longer come later: a rover that is slower than its plan may not end them."""
NEAR_S = 20.0
"""A way near the fence costs as much as one that takes so much longer."""
RAMP_S = 1.0
"""Time from rest to the speed of a piece."""
SLOW_M, SLOW_M_S = 0.3, 0.04
"""The last way into the place, and its speed."""
PAUSE_S = 0.5
"""Rest between two pieces."""
LOOK_S = 2.0
"""Rest before the last, slow way: external poses are most exact for a rover that stands."""
SETTLE_S = 3.0
"""Rest at the end of a way, to come to rest."""
DOCK_S = 8.0
"""Rest at the place, at the end of which the rover must stand."""
FAR_M = 3.0
"""Largest distance of a start from the staging pose."""
SMALL_M, SMALL_RAD = 0.02, 0.03
"""Shorter pieces are left out: the approach corrects them."""
CHECKPOINT_TICKS = 10
DETOURS_M = (0.5, 0.0), (1.0, 0.0), (0.0, 0.8), (0.0, -0.8), (0.8, 0.8), (0.8, -0.8)
"""Points of detours: how much farther out than the staging pose, and how far to its left."""


class Piece(NamedTuple):
    """A straight piece or a turn on the spot, from rest to rest."""

    length_m: float
    turn_rad: float
    rest_s: float = PAUSE_S
    speed_m_s: float = EASE * V_MAX
    rate_rad_s: float = EASE * OMEGA_MAX


@dataclass(frozen=True)
class Way:
    """One way of a docking: its course with its reference, both of the base."""

    course: Course
    reference: Reference
    backward: bool

    def of_tail(self) -> tuple[Course, Reference]:
        """Return course and reference of the tail, which drives the way as a front drives another."""
        points = tuple(
            point.model_copy(update=tail(point.pose)._asdict()) for point in self.course.checkpoints
        )
        first, (v, omega) = self.course.checkpoints[0].pose, self.reference.motion.T
        reference = drive_profile(tail(first), (-v).tolist(), omega.tolist())
        return self.course.model_copy(update={"checkpoints": points}), reference


class Fenced(NamedTuple):
    """What a plan needs to know of the gate's fence."""

    room: Room
    odometry: Pose
    """Where odometry shows the rover at the start of a way."""
    turn_gain: float
    """True turn over odometry's."""
    onwards: Way
    """The way that follows: the approach."""

    def fit(self, way: Way) -> Fit:
        """Return how a way to the staging pose and the approach fit into the room."""
        return self.room.fit([way.reference, self.onwards.reference], self.odometry, self.turn_gain)


def tail(pose: Pose) -> Pose:
    """Return a pose turned by 180°: that of the rover's tail."""
    return turned(pose, math.pi)


def approach(place: Place, slower: float = 1.0, further_m: float = 0.0) -> Way:
    """Return the way from the staging pose into the place; ``slower`` as for courses.

    Its reference goes on for ``further_m``, for a policy that stops before the end of it.
    """
    first = max(place.staging_m - SLOW_M, 0.0)
    slow_m = place.staging_m - first + further_m
    pieces = [Piece(first, 0.0, LOOK_S), Piece(slow_m, 0.0, DOCK_S, SLOW_M_S)]
    way = _way(place, place.name, place.staging, pieces, backward=place.backward, slower=slower)
    # The reference ends at the place but for rounding, and for what it goes further.
    *points, last = way.course.checkpoints
    points.append(last.model_copy(update=place.goal._asdict()))
    course = way.course.model_copy(update={"checkpoints": tuple(points)})
    return Way(course, way.reference, way.backward)


def retreat(place: Place, slower: float = 1.0, out_m: float = 0.0) -> Way:
    """Return the way back to the staging pose, from the place or from so far out of it."""
    start = compose(place.goal, Pose(out_m if place.backward else -out_m, 0.0, 0.0))
    pieces = [Piece(place.staging_m - out_m, 0.0, SETTLE_S)]
    return _way(place, "retreat", start, pieces, backward=not place.backward, slower=slower)


def in_the_way(place: Place, way: Way, robot: RobotDescription | None = None) -> str:
    """Return which of the place's obstacles an approach touches before the place, in words; "" if none."""
    robot = load_description(DEFAULT_ROBOT) if robot is None else robot
    for tick in range(way.reference.ticks + 1):
        pose, _ = way.reference.tick(tick)
        # What it touches at its place may be the dock.
        out_m = place.out_m(pose)
        for number, obstacle in enumerate(place.obstacles, 1):
            if out_m > AT_PLACE_M and clearance_at(pose, [obstacle], robot) == 0.0:
                return f"the approach touches obstacle {number}, {out_m:.2f} m before {place.name}"
    return ""


def to_staging(
    place: Place,
    start: Pose,
    robot: RobotDescription | None = None,
    slower: float = 1.0,
    *,
    detours: bool = True,
    sight: Sight | None = None,
    fenced: "Fenced | None" = None,
) -> tuple[Way | None, tuple[Problem | str, ...]]:
    """Return the best clear way from ``start`` to the staging pose, or None and why there is none.

    The rover turns on the spot, drives straight, and turns on the spot; or it does so by one more point. The
    best way is the shortest in time, where time without tags in view counts twice. Ways that lose the tags
    for long, or leave the fence's room if the turn gain is another one, come later. ``sight`` is the camera,
    if it is known. With a fence the rover may begin with the turn to the other side: errors of odometry's
    turns then cancel those of earlier ones.
    """
    ways, problems = [], tuple[Problem | str, ...]()
    for detour in (None, *(DETOURS_M if detours else ())):
        via = [] if detour is None else [_beside(place, *detour)]
        for backward in (False, True):
            pieces = list(_pieces([start, *via, place.staging], backward))
            for each in (pieces, _turned_about(pieces)) if fenced else (pieces,):
                ways.append(_way(place, "staging", start, each, backward=backward, slower=slower))
    lost = [blind(place, way.reference, sight) for way in ways]
    fits = [fenced.fit(way) if fenced else Fit(0, near=False) for way in ways]
    for way, gap, fit in sorted(zip(ways, lost, fits, strict=True), key=lambda each: _cost(*each)):
        if fenced is not None and fit.left is not None:
            problems = problems or (fenced.room.words(fit.left),)
            continue
        if gap is not None and gap.seconds > BLIND_S:
            remedy = "start nearer to the tags, or hang up tags that are in view there"
            problems = problems or (f"{gap} (at most {BLIND_S:g} s); {remedy}",)
            continue
        found = check_course(way.course, robot, way.reference, clearance=False)
        if found.drivable:
            return way, ()
        problems = problems or found.problems
    return None, problems


def _cost(way: Way, gap: Blind | None, fit: Fit) -> tuple[bool, int, float]:
    lost_s = gap.seconds if gap else 0.0
    seconds = way.course.horizon_s + lost_s + NEAR_S * fit.near
    return fit.left is not None, fit.risk + (lost_s > SURE_S), seconds


def _turned_about(pieces: Sequence[Piece]) -> list[Piece]:
    """Return pieces of which the first turn goes the other way round."""
    found = list(pieces)
    for number, piece in enumerate(found):
        if piece.turn_rad:
            turn = piece.turn_rad - math.copysign(math.tau, piece.turn_rad)
            found[number] = piece._replace(turn_rad=turn, rate_rad_s=BACK_TURN_RAD_S)
            break
    return found


def _beside(place: Place, farther_m: float, left_m: float) -> Pose:
    """Return the pose that lies so much farther out than the staging pose, and to its left."""
    return compose(place.staging, Pose(farther_m if place.backward else -farther_m, left_m, 0.0))


def _pieces(poses: Sequence[Pose], backward: bool) -> Iterator[Piece]:
    """Yield the pieces through the positions of poses, from the first one's heading to the last one's."""
    heading = poses[0].theta
    for a, b in pairwise(poses):
        if distance(a, b) > SMALL_M:
            bearing = math.atan2(b.y - a.y, b.x - a.x) + (math.pi if backward else 0.0)
            yield from _turn(wrap_angle(bearing - heading))
            yield Piece(distance(a, b), 0.0)
            heading = bearing
    yield from _turn(wrap_angle(poses[-1].theta - heading))
    yield Piece(0.0, 0.0, SETTLE_S)


def _turn(angle: float) -> Iterator[Piece]:
    if abs(angle) > SMALL_RAD:
        yield Piece(0.0, angle)


def _way(
    place: Place, name: str, start: Pose, pieces: Sequence[Piece], *, backward: bool, slower: float
) -> Way:
    """Return the way of pieces from ``start`` of the base; lengths count in the direction of the way."""
    v, omega = [0.0] * round(PAUSE_S / TICK_S), [0.0] * round(PAUSE_S / TICK_S)
    for piece in pieces:
        along = _profile(piece.length_m, piece.speed_m_s / slower)
        turning = _profile(piece.turn_rad, piece.rate_rad_s / slower)
        rest = [0.0] * round(piece.rest_s / TICK_S)
        v += along + [0.0] * len(turning) + rest
        omega += [0.0] * len(along) + turning + rest
    reference = drive_profile(start, [-speed for speed in v] if backward else v, omega)
    ticks = reference.ticks
    if (seconds := ticks * TICK_S) > MAX_HORIZON_S:
        raise UsageError(f"{place.name}: one way would take {seconds:.0f} s (at most {MAX_HORIZON_S:g} s)")
    at = [*range(0, ticks, max(CHECKPOINT_TICKS, math.ceil(ticks / (MAX_CHECKPOINTS - 1)))), ticks]
    points = tuple(Checkpoint(t=round(k * TICK_S, 1), **reference.tick(k)[0]._asdict()) for k in at)
    course = Course(
        name=name,
        start_signal_s=0.0,
        horizon_s=round(ticks * TICK_S, 1),
        checkpoints=points,
        obstacles=place.obstacles,
        parked=ParkedRule(position_m=place.position_m, heading_rad=place.heading_rad),
    )
    return Way(course, reference, backward)


def _profile(way: float, speed: float) -> list[float]:
    """Return speeds at ticks from rest to rest, linear between them, whose integral is ``way``."""
    if way == 0.0:
        return []
    ramp = round(RAMP_S / TICK_S)
    ticks = max(2 * ramp, math.ceil(abs(way) / (speed * TICK_S)) + ramp)
    top = way / ((ticks - ramp) * TICK_S)
    return [top * min(k, ramp, ticks - k) / ramp for k in range(1, ticks + 1)]
