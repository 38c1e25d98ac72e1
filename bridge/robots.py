"""The Pioneers we know: how their packets turn into metres, their outline, their limits, their sonars.

Sources: ARIA's params/p3at.p, p3at-sh.p, p3dx.p, p3dx-sh.p and ArRobotTypes (all numbers but one; Player's
robot_params has the same conversion factors); heading units as every client uses them, 4096 a turn.
"""

import math
from dataclasses import dataclass

from rover_ncp.core.geometry import Pose

__all__ = ["ROBOTS", "RobotParameters", "parameters_for"]


@dataclass(frozen=True)
class RobotParameters:
    """Factors from packet units to SI, and dimensions in m, m/s, rad/s."""

    name: str
    distance_m: float
    """Metres per unit of XPOS and YPOS."""
    half_track_m: float
    """Half the difference of wheel speeds over this is the turn rate; a skid-steered base's is effective."""
    length_m: float
    width_m: float
    v_max: float
    omega_max: float
    sonars: tuple[Pose, ...]
    """Sonar poses in the base's frame; the place is the sonar's number."""

    @property
    def theta_rad(self) -> float:
        """Radians per unit of THPOS."""
        return math.tau / 4096

    @property
    def velocity_m_s(self) -> float:
        """Metres per second per unit of wheel speed."""
        return 0.001


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


def _at(name: str, distance_mm: float) -> RobotParameters:
    """Pioneer 3-AT: DiffConvFactor 0.0034, 626 mm by 505 mm, 1200 mm/s, 300 deg/s."""
    return RobotParameters(
        name, distance_mm / 1000, 0.001 / 0.0034, 0.626, 0.505, 1.2, math.radians(300), _AT_SONARS
    )


def _dx(name: str, distance_mm: float) -> RobotParameters:
    """Pioneer 3-DX: DiffConvFactor 0.0056, 511 mm by 425 mm, 2200 mm/s, 500 deg/s."""
    return RobotParameters(
        name, distance_mm / 1000, 0.001 / 0.0056, 0.511, 0.425, 2.2, math.radians(500), _DX_SONARS
    )


ROBOTS = {
    robot.name: robot
    for robot in (_at("p3at", 0.465), _at("p3at-sh", 1.0), _dx("p3dx", 0.485), _dx("p3dx-sh", 1.0))
}
"""By subtype as the base tells it in SYNC2 (``-sh``: the SH2 controller that runs ARCOS)."""


def parameters_for(subtype: str) -> RobotParameters | None:
    """Return what is known of a subtype, whatever its case; None for a base we do not know."""
    return ROBOTS.get(subtype.lower())
