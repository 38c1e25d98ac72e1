"""A robot description as a simulated rover, and the ranges in which robots of that model differ.

Which robots a driver meets: their start is known to 10 cm and 10°, commands get lost, wheels slip and a cable
lies on the way, as in the randomization harsh. Delays and odometry are those of the description.
"""

from functools import cache

from rover_ncp.core.robot_description import RobotDescription, load_description
from sim.world.randomization import Randomization, load_randomization
from sim.world.rover import RoverModel

DEFAULT = "p3at-sh"
"""The robot that is simulated unless another is named: the paper's."""
OWN = "robot"
"""The name of a description's own ranges, in place of a randomization's."""
DELAYS = (0.5, 2.0)
"""Least and greatest delay over the usual one."""
CENTER = 0.1
"""The centre of rotation of a skid-steered robot is within this share of its length."""


@cache
def default_rover(**different: float) -> RoverModel:
    """Return the simulated Pioneer 3-AT, or one with other values."""
    return described_rover(load_description(DEFAULT)).model_copy(update=different)


def described_rover(description: RobotDescription) -> RoverModel:
    """Return the simulated rover of a description. Its outline lies evenly around its centre of rotation."""
    return RoverModel(
        **description.motion.model_dump(),
        delay_v_s=description.delays.v_s,
        delay_omega_s=description.delays.omega_s,
        length=description.length_m,
        width=description.width_m,
        mass=description.mass_kg,
    )


def ranges_of(description: RobotDescription) -> Randomization:
    """Return the ranges of a described model; a ROS 2 robot adds the noise of its odometry itself."""
    delays, odometry = description.delays, description.odometry
    own = {
        "name": description.name,
        "delay_v_s": _times(delays.v_s),
        "delay_omega_s": _times(delays.omega_s),
        "odometry_scale": odometry.distance_error,
        "noise_m": odometry.noise_m,
        "noise_rad": odometry.noise_rad,
    }
    if description.drive.kind == "skid":
        own["turn_gain"] = 1.0 - odometry.turn_error, 1.0 + odometry.turn_error
        own["rotation_center_m"] = CENTER * description.length_m
    if description.arcos is None:
        own |= {"speed_step_m_s": 0.0, "turn_step_rad_s": 0.0, "noise_m": 0.0, "noise_rad": 0.0}
    return load_randomization("harsh").model_copy(update=own)


def _times(delay_s: float) -> tuple[float, float]:
    return DELAYS[0] * delay_s, DELAYS[1] * delay_s
