"""The known Pioneer models: conversion factors, outline, limits, sonars.

Sources: ARIA's params/p3at.p, p3at-sh.p, p3dx.p, p3dx-sh.p and ArRobotTypes (all numbers but one; Player's
robot_params has the same conversion factors); heading units as every client uses them, 4096 a turn. Heights
and wheels are those of the maker's own 3D models, where these have them; only pictures depend on them.
"""

import math
from dataclasses import dataclass, replace

from bridge.base import RobotShape, Wheels
from rover_ncp.core.geometry import Pose


@dataclass(frozen=True)
class RobotParameters(RobotShape):
    """Factors from packet units to SI, and limits in m/s and rad/s."""

    distance_m: float
    """Metres per unit of XPOS and YPOS."""
    half_track_m: float
    """Half the difference of wheel speeds over this is the turn rate; a skid-steered base's is effective."""
    v_max: float
    omega_max: float


HEADING_RAD = math.tau / 4096
"""Radians per unit of THPOS."""
WHEEL_SPEED_M_S = 0.001
"""Metres per second per unit of wheel speed."""


def _sonars(*poses_mm_deg: tuple[int, int, int]) -> tuple[Pose, ...]:
    return tuple(Pose(x / 1000, y / 1000, math.radians(th)) for x, y, th in poses_mm_deg)


_AT_SONARS = _sonars(
    *((147, 136, 90), (193, 119, 50), (227, 79, 30), (245, 27, 10)),
    *((245, -27, -10), (227, -79, -30), (193, -119, -50), (147, -136, -90)),
    *((-144, -136, -90), (-189, -119, -130), (-223, -79, -150), (-241, -27, -170)),
    *((-241, 27, 170), (-223, 79, 150), (-189, 119, 130), (-144, 136, 90)),
)
_DX_SONARS = _sonars(
    *((69, 136, 90), (114, 119, 50), (148, 78, 30), (166, 27, 10)),
    *((166, -27, -10), (148, -78, -30), (114, -119, -50), (69, -136, -90)),
    *((-157, -136, -90), (-203, -119, -130), (-237, -78, -150), (-255, -27, -170)),
    *((-255, 27, 170), (-237, 78, 150), (-203, 119, 130), (-157, 136, 90)),
)


_AT_WHEELS = Wheels(0.111, 0.075, tuple((x, y) for x in (0.135, -0.135) for y in (0.197, -0.197)))
_DX_WHEELS = Wheels(0.0975, 0.0475, ((0.0, 0.165), (0.0, -0.165)))


_P3AT = RobotParameters(  # DiffConvFactor 0.0034, 626 mm by 505 mm, 1200 mm/s, 300 deg/s
    "p3at",
    distance_m=0.465e-3,
    half_track_m=0.001 / 0.0034,
    front_m=0.313,
    rear_m=0.313,
    width_m=0.505,
    height_m=0.277,
    v_max=1.2,
    omega_max=math.radians(300),
    sonars=_AT_SONARS,
    sonar_height_m=0.25,
    wheels=_AT_WHEELS,
)
_P3DX = RobotParameters(  # DiffConvFactor 0.0056, 511 mm by 425 mm, 2200 mm/s, 500 deg/s
    "p3dx",
    distance_m=0.485 / 1000,
    half_track_m=0.001 / 0.0056,
    front_m=0.210,
    rear_m=0.301,
    width_m=0.425,
    height_m=0.237,
    v_max=2.2,
    omega_max=math.radians(500),
    sonars=_DX_SONARS,
    sonar_height_m=0.208,
    wheels=_DX_WHEELS,
)
ROBOTS = {
    "p3at": _P3AT,
    "p3at-sh": replace(_P3AT, name="p3at-sh", distance_m=1e-3),
    "p3dx": _P3DX,
    "p3dx-sh": replace(_P3DX, name="p3dx-sh", distance_m=1e-3),
}
"""By the subtype that the base reports in SYNC2 (``-sh``: the SH2 controller that runs ARCOS)."""
