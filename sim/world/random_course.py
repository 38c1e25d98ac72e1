"""Random courses: random drives of a rover within the motors' limits, so that each course is drivable.

A drive is a few pieces of constant speed and turn rate, joined over half a second, from rest to rest. A third
of the pieces are straight, and a third are nearly as sharp as the motors turn. The course's checkpoints are
the rover's poses at each second. Course 7 of a seed does not depend on the other courses drawn.
"""

from typing import Any

import numpy as np

from rover_ncp.core.geometry import Pose, wrap_angle
from rover_ncp.core.streams import Domain, random_stream
from rover_ncp.course.course import OMEGA_MAX, TICK_S, Checkpoint, Course, Obstacle
from rover_ncp.course.reference import Reference, drive_profile

HORIZON_S = 32.0
"""As the paper's course."""
_KNOT_S = 0.5
_REST_S = 9.0
"""At the end, to come to rest and be seen at rest."""
_SPEED_M_S = (0.05, 0.14)
_SHARP_RAD_S = 0.15
_SHARE = 1.0 / 3.0
"""The share of straight pieces, and of sharp ones."""
_DECIMALS = 6


def random_course(seed: int, number: int) -> tuple[Course, Reference]:
    """Return course ``number`` of a seed, and the drive it was made from."""
    stream = random_stream(seed, Domain.COURSE, number)
    knots = round(HORIZON_S / _KNOT_S) + 1
    v, omega = np.zeros(knots), np.zeros(knots)
    begin = at = int(stream.integers(2, 8))
    end = int(stream.integers(at + 10, round((HORIZON_S - _REST_S) / _KNOT_S)))
    while at < end:
        piece = slice(at, min(at + int(stream.integers(3, 11)), end))
        v[piece] = stream.uniform(*_SPEED_M_S)
        omega[piece] = _turn(stream)
        at = piece.stop
    ticks = np.arange(round(HORIZON_S / TICK_S) + 1) * TICK_S
    times = _KNOT_S * np.arange(knots)
    drive = drive_profile(
        Pose(0.0, 0.0, 0.0), np.interp(ticks, times, v).tolist(), np.interp(ticks, times, omega).tolist()
    )
    # The last piece is left over the knot that follows it.
    under_way = np.arange(_KNOT_S * (begin - 1), _KNOT_S * end, 1.0).tolist()
    deadlines = [0.0, *under_way, _KNOT_S * end, HORIZON_S]
    course = Course(
        name=f"random-{seed}-{number}",
        start_signal_s=_KNOT_S * (begin - 1),
        horizon_s=HORIZON_S,
        checkpoints=tuple(_checkpoint(drive, t) for t in deadlines),
    )
    return course, drive


def _turn(stream: np.random.Generator) -> float:
    kind, side, size = stream.random(), stream.choice([-1.0, 1.0]), stream.random()
    if kind < _SHARE:
        return 0.0
    least = _SHARP_RAD_S if kind < 2.0 * _SHARE else 0.0
    return float(side * (least + (OMEGA_MAX - least) * size))


def _checkpoint(drive: Reference, t: float) -> Checkpoint:
    pose, _ = drive.at(t)
    x, y = round(pose.x, _DECIMALS), round(pose.y, _DECIMALS)
    return Checkpoint(t=t, x=x, y=y, theta=round(wrap_angle(pose.theta), _DECIMALS))


def mirrored(course: Course) -> Course:
    """Return a course with left and right exchanged."""

    def flip(thing: Checkpoint | Obstacle) -> Any:
        return thing.model_copy(update={"y": -thing.y, "theta": -thing.theta})

    return course.model_copy(
        update={
            "name": f"{course.name}-mirrored",
            "checkpoints": tuple(flip(point) for point in course.checkpoints),
            "obstacles": tuple(flip(obstacle) for obstacle in course.obstacles),
        }
    )


def mirrored_reference(reference: Reference) -> Reference:
    """Return a reference with left and right exchanged."""
    return Reference(reference.poses * np.array([1.0, -1.0, -1.0]), reference.motion * np.array([1.0, -1.0]))
