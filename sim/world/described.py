"""A robot description as a simulated rover, and the ranges in which robots of that model differ.

Start, accelerations, gains, slip, drift and a push on the way are those of the randomization harsh; delays
and odometry are those of the description.
"""

from functools import cache
from pathlib import Path
from typing import Any

from rover_ncp.core.errors import UsageError
from rover_ncp.core.files import DEFAULT_ROBOT
from rover_ncp.robot.description import RobotDescription, load_description
from rover_ncp.robot.profile import load_profile
from sim.world.bodies import PRESETS, Body
from sim.world.randomization import Randomization, load_randomization
from sim.world.rover import RoverModel

DELAYS = (0.5, 2.0)
"""Least and greatest delay over the usual one."""
CENTER = 0.1
"""The centre of rotation of a skid-steered robot is within this share of its length."""


@cache
def default_rover(**different: float) -> RoverModel:
    """Return the simulated Pioneer 3-AT, or one with other values."""
    return described_rover(load_description(DEFAULT_ROBOT)).model_copy(update=different)


def described_rover(description: RobotDescription, *, motors: bool = False) -> RoverModel:
    """Return the simulated rover of a description. Its outline lies evenly around its centre of rotation.

    Without ``motors`` it follows slow commands too: a driver, which plain simulation does without, sends none
    that the described motors do not follow.
    """
    motion = description.motion
    slow: dict[str, Any] = {
        "dead_band_v": motion.dead_band.v,
        "dead_band_omega": motion.dead_band.omega,
        "stiction": motion.dead_band.stiction,
        "wheel_min": motion.wheel_min,
        "slow_wheels_turn": motion.slow_wheels == "turn",
    }
    return RoverModel(
        **motion.model_dump(exclude={"dead_band", "wheel_min", "slow_wheels"}),
        **(slow if motors else {}),
        half_track_m=description.half_track_m,
        delay_v_s=description.delays.v_s,
        delay_omega_s=description.delays.omega_s,
        length=description.length_m,
        width=description.width_m,
        mass=description.mass_kg,
    )


def ranges_of(description: RobotDescription, body: Body = Body.PYMUNK) -> Randomization:
    """Return the ranges of a described model; a ROS 2 robot adds the noise of its odometry itself.

    On the second body they are those of the randomization varied, with the description's delays.
    """
    delays, odometry = description.delays, description.odometry
    if body is Body.MUJOCO:
        varied = load_randomization("varied", body)
        late = {"delay_v_s": _times(delays.v_s), "delay_omega_s": _times(delays.omega_s)}
        return varied.model_copy(update={"name": description.name, **late})
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
        # Over TCP, to the robot's own computer: few get lost, and one at a time.
        own |= {"lost": 0.05, "burst": 1.0}
    return load_randomization("harsh").model_copy(update=own)


def ranges_for(
    name_or_path: str | Path | None,
    profile: Path | None,
    body: Body = Body.PYMUNK,
    robot: RobotDescription | None = None,
) -> Randomization:
    """Load ranges, with the profile of the known rover, if any.

    Without a name they are those of the robot, or else a body's nominal ones. Raises UsageError.
    """
    if body is Body.MUJOCO and robot is not None and robot.drive.kind != "skid":
        raise UsageError(f"--body mujoco has four wheels; {robot.name} has two")
    if name_or_path is None and robot is not None:
        ranges = ranges_of(robot, body)
    else:
        ranges = load_randomization(PRESETS[body][0] if name_or_path is None else name_or_path, body)
    return ranges if profile is None else ranges.model_copy(update={"rover": load_profile(profile)})


def _times(delay_s: float) -> tuple[float, float]:
    return DELAYS[0] * delay_s, DELAYS[1] * delay_s
