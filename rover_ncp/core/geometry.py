"""Poses in the plane, and the frame convention of the whole project.

``pose_AB`` is the pose of frame B measured in frame A: (x, y) is B's origin in A's axes in metres, theta
the angle from A's x-axis to B's in radians, counter-clockwise positive, wrapped to (−π, π]. Frames:

    course  the course's own frame; its checkpoints are poses of the base in it
    odom    where the base's counters were zero; drifts against the course
    base    the rover's middle, midway between its wheels, x forward, y to the left (REP-103)

Poses chain as their letters do: ``compose(pose_AB, pose_BC)`` is ``pose_AC``.
"""

import math
from typing import NamedTuple


class Pose(NamedTuple):
    """A pose in the plane: x and y in metres, theta in radians."""

    x: float
    y: float
    theta: float


class Velocity(NamedTuple):
    """Motion of the base: v forward in m/s, omega counter-clockwise in rad/s."""

    v: float
    omega: float


ORIGIN = Pose(0.0, 0.0, 0.0)
STANDSTILL = Velocity(0.0, 0.0)


def wrap_angle(angle: float) -> float:
    """Return the same direction within (−π, π], in radians."""
    wrapped = math.remainder(angle, math.tau)
    return math.pi if wrapped == -math.pi else wrapped


def compose(pose_ab: Pose, pose_bc: Pose) -> Pose:
    """Chain two poses: the pose of C in A."""
    c, s = math.cos(pose_ab.theta), math.sin(pose_ab.theta)
    return Pose(
        pose_ab.x + c * pose_bc.x - s * pose_bc.y,
        pose_ab.y + s * pose_bc.x + c * pose_bc.y,
        wrap_angle(pose_ab.theta + pose_bc.theta),
    )


def inverse(pose_ab: Pose) -> Pose:
    """Return the pose of A in B."""
    c, s = math.cos(pose_ab.theta), math.sin(pose_ab.theta)
    return Pose(
        -c * pose_ab.x - s * pose_ab.y,
        s * pose_ab.x - c * pose_ab.y,
        wrap_angle(-pose_ab.theta),
    )


def relative(pose_ab: Pose, pose_ac: Pose) -> Pose:
    """Return the pose of C seen from B, both given in A."""
    return compose(inverse(pose_ab), pose_ac)


def turned(pose: Pose, angle: float) -> Pose:
    """Return a pose with its heading turned by an angle in radians."""
    return Pose(pose.x, pose.y, wrap_angle(pose.theta + angle))


def distance(a: Pose, b: Pose) -> float:
    """Return the distance between two origins in metres, both poses given in one frame."""
    return math.hypot(a.x - b.x, a.y - b.y)


def same_frame(found: str, expected: str) -> bool:
    """Return whether a frame_id names the expected frame.

    Only the part behind the last slash counts, since robots of a fleet differ before it. An empty frame_id
    names any frame: many drivers leave it out.
    """
    name, expected_name = (frame.rpartition("/")[2] for frame in (found, expected))
    return not name or not expected_name or name == expected_name


def near(a: Pose, b: Pose, position_m: float, heading_rad: float) -> bool:
    """Return whether two poses in one frame differ by no more than this."""
    return distance(a, b) <= position_m and abs(wrap_angle(a.theta - b.theta)) <= heading_rad
