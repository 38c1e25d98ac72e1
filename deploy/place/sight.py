"""Where on a way the localiser's camera sees tags, by their places and by what is known of the camera."""

import math
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from deploy.place.place import Place
from rover_ncp.core.config import StrictModel
from rover_ncp.core.geometry import Pose
from rover_ncp.course.course import TICK_S
from rover_ncp.course.reference import FloatArray, Reference

VIEW_RAD, VIEW_M = math.radians(30.0), 3.0
"""Where a camera that is not known sees tags: so far to either side, as most cameras do, and so far away."""

Metres = Annotated[float, Field(ge=-1e4, le=1e4)]
Angle = Annotated[float, Field(ge=-2 * math.pi, le=2 * math.pi)]


class SeenTag(StrictModel):
    """The left and the right edge of a tag for its reader, in the frame of the place."""

    left: tuple[Metres, Metres]
    right: tuple[Metres, Metres]


class Sight(StrictModel):
    """A camera on the rover, and the tags that it may see. Heights are left out."""

    x: Metres = Field(description="of the camera on the base, ahead, m")
    y: Metres = Field(description="to the left, m")
    yaw: Angle = Field(description="direction in which it looks, from ahead to the left")
    to_left: Angle = Field(description="how far it sees to the left of that direction")
    to_right: Angle = Field(description="to the right, a negative angle")
    tags: tuple[SeenTag, ...] = Field(min_length=1, max_length=200)


class Blind(NamedTuple):
    """The longest motion of a way without tags in view: its time, and where it begins and ends."""

    seconds: float
    begin: Pose
    end: Pose

    def __str__(self) -> str:
        places = (f"x {pose.x:.2f} m, y {pose.y:.2f} m" for pose in (self.begin, self.end))
        return f"the way loses the tags for {self.seconds:.0f} s of motion, from {' to '.join(places)}"


def blind(place: Place, reference: Reference, sight: Sight | None) -> Blind | None:
    """Return the longest motion without tags in view, None if there is none or the tags are not known.

    Without a known camera, one in the middle of the rover looks ahead or back, whichever is nearer to the
    tags when the rover stands in its place.
    """
    if sight is not None:
        sees = seen(reference.poses, sight)
    elif place.tags is not None:
        sees = _assumed(reference.poses, place.goal, (place.tags.x, place.tags.y))
    else:
        return None
    moves = (reference.motion != 0.0).any(axis=1)
    longest = ticks = first = begin = end = 0
    for tick, (in_view, moving) in enumerate(zip(sees.tolist(), moves.tolist(), strict=True)):
        if in_view:
            ticks, first = 0, tick + 1
            continue
        ticks += moving
        if ticks > longest:
            longest, begin, end = ticks, first, tick
    if not longest:
        return None
    return Blind(longest * TICK_S, *(Pose(*reference.poses[tick].tolist()) for tick in (begin, end)))


def _assumed(poses: FloatArray, goal: Pose, tags: tuple[float, float]) -> NDArray[np.bool_]:
    behind = abs(_bearings(np.array([goal]), tags)[0]) > math.pi / 2
    poses = poses + np.array([0.0, 0.0, math.pi if behind else 0.0])
    in_view: NDArray[np.bool_] = np.abs(_bearings(poses, tags)) <= VIEW_RAD
    in_view &= np.hypot(*(poses[:, :2] - tags).T) <= VIEW_M
    return in_view


def seen(poses: FloatArray, sight: Sight) -> NDArray[np.bool_]:
    """Return at which poses the front of a whole tag is in view."""
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    x, y = poses[:, 0] + c * sight.x - s * sight.y, poses[:, 1] + s * sight.x + c * sight.y
    cameras = np.column_stack([x, y, poses[:, 2] + sight.yaw])
    found: NDArray[np.bool_] = np.zeros(len(poses), np.bool_)
    for tag in sight.tags:
        left, right = _bearings(cameras, tag.left), _bearings(cameras, tag.right)
        near = np.hypot(*(cameras[:, :2] - tag.left).T) <= VIEW_M
        found |= near & (sight.to_right <= right) & (right < left) & (left <= sight.to_left)
    return found


def _bearings(poses: FloatArray, point: tuple[float, float]) -> FloatArray:
    """Return the angle from each pose's heading to a point."""
    away = np.array(point) - poses[:, :2]
    found: FloatArray = np.angle(np.exp(1j * (np.arctan2(away[:, 1], away[:, 0]) - poses[:, 2])))
    return found
