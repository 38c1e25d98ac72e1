"""The known Pioneer models: their descriptions with the factors of ARCOS in SI units.

Headings have the units that every client uses, 4096 a turn.
"""

import math
from dataclasses import dataclass

from bridge.base import RobotShape, shape_of
from rover_ncp.robot.description import RobotDescription, load_description


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


def parameters_of(description: RobotDescription) -> RobotParameters:
    """Return the parameters of a described Pioneer, which has ``arcos``."""
    arcos, shape = description.arcos, shape_of(description)
    assert arcos is not None
    return RobotParameters(
        **vars(shape),
        distance_m=arcos.distance_mm / 1000,
        half_track_m=0.001 / arcos.diff_conv_factor,
        v_max=arcos.v_top_mm_s / 1000,
        omega_max=math.radians(arcos.omega_top_deg_s),
    )


NAMES = ("p3at", "p3at-sh", "p3dx", "p3dx-sh")
ROBOTS = {name: parameters_of(load_description(name)) for name in NAMES}
"""By the subtype that the base reports in SYNC2 (``-sh``: the SH2 controller that runs ARCOS)."""
