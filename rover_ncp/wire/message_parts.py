"""Parts that ROS messages have in common: the header with its stamp, and the pose of a rover in the plane."""

import functools
import logging
import math
from typing import Any

from rover_ncp.core.clock_offset import NS_PER_S
from rover_ncp.core.errors import FormatError
from rover_ncp.core.geometry import Pose

_LOGGER = logging.getLogger("rover_ncp")
UPRIGHT = math.cos(math.radians(30.0))
"""Least vertical part of a pose's z axis: no rover stands on a steeper slope."""
_UNIT_TOLERANCE = 0.1
"""How far the squared length of a rotation's quaternion may be from 1: some publishers round to float32."""


def header_of(stamp_ns: int, frame: str) -> dict[str, Any]:
    """Return a Header, as `encode` takes one.

    ROS has 32 bits for the seconds, until 2038-01-19. A later stamp becomes 0, which receivers take for a
    publisher without a clock.
    """
    seconds, nanoseconds = divmod(stamp_ns, NS_PER_S)
    if not -(2**31) <= seconds < 2**31:
        _warn_of_clock()
        seconds = nanoseconds = 0
    return {"stamp": {"sec": seconds, "nanosec": nanoseconds}, "frame_id": frame}


@functools.cache
def _warn_of_clock() -> None:
    _LOGGER.warning(
        "a clock is outside the time that ROS's stamps can hold (1901 to 2038-01-19): messages go out with "
        "the stamp 0; set the clock of this computer, or of the robot"
    )


def read_stamp_ns(header: Any) -> int:
    """Return the stamp of a Header, in ns. Raises FormatError."""
    if header.stamp.nanosec >= NS_PER_S:
        raise FormatError(f"a stamp of {header.stamp.nanosec} ns beyond its seconds, expected less than 10⁹")
    return int(header.stamp.sec) * NS_PER_S + int(header.stamp.nanosec)


def rotation_of(yaw: float) -> dict[str, float]:
    """Return a Quaternion, as `encode` takes one."""
    return {"z": math.sin(0.5 * yaw), "w": math.cos(0.5 * yaw)}


def pose_of(pose: Pose) -> dict[str, Any]:
    """Return a Pose, as `encode` takes one."""
    return {"position": {"x": pose.x, "y": pose.y}, "orientation": rotation_of(pose.theta)}


def read_planar_pose(pose: Any) -> Pose:
    """Return the pose in the plane. Raises FormatError for what is no rotation, or lies on its side."""
    yaw, q = read_yaw(pose.orientation), pose.orientation
    upright = 1.0 - 2.0 * (q.x * q.x + q.y * q.y)
    if upright < UPRIGHT:
        tilt = math.degrees(math.acos(max(upright, -1.0)))
        raise FormatError(
            f"the pose lies on its side: its z axis is {tilt:.0f}° from vertical, expected z up (REP-103); a "
            "motion capture with y up has to be set to z up"
        )
    return Pose(pose.position.x, pose.position.y, yaw)


def read_yaw(q: Any) -> float:
    """Return the heading of a message's quaternion. Raises FormatError for what is no rotation."""
    if not abs(q.x * q.x + q.y * q.y + q.z * q.z + q.w * q.w - 1.0) <= _UNIT_TOLERANCE:
        raise FormatError(f"the orientation {q.x:g}, {q.y:g}, {q.z:g}, {q.w:g} is not a rotation")
    return math.atan2(2.0 * (q.w * q.z + q.x * q.y), 1.0 - 2.0 * (q.y * q.y + q.z * q.z))
