"""Settings of a drive to a place, and its controller; deploy, replay and the stack simulation use them."""

from typing import Any

from deploy.drive.config import DriveConfig, settings_for
from deploy.place.docking import MAX_DRIVE_S, Docking
from deploy.place.place import Place
from rover_ncp.circuit.policy import Policy
from rover_ncp.course.course import TICK_S
from rover_ncp.robot.description import RobotDescription
from rover_ncp.robot.profile import RoverProfile

BLIND_S = 60.0
"""How long the rover may move by odometry alone, where poses are lost."""


def place_config(
    place: Place,
    rover: RoverProfile | None,
    described: RobotDescription | None,
    *,
    undock: bool = False,
    **settings: Any,
) -> DriveConfig:
    """Return the settings of a drive to a place, or out of it; ``settings`` are further ones."""
    about: dict[str, Any] = {
        "place": place,
        "undock": undock,
        "course": place.name,
        "ticks": round(MAX_DRIVE_S / TICK_S),
        # A docked rover is where its place is, also if its poses are hidden there.
        "pose": "auto" if undock else "required",
        "pose_age_s": BLIND_S,
        "pose_frame": place.frame,
        "estimator": settings_for(rover, described),
        "rover": rover,
        "described": described,
    }
    return DriveConfig(**about | settings)


def docking_of(config: DriveConfig, staging: Policy, dock: Policy) -> Docking:
    """Return the controller of a drive to a place."""
    assert config.place is not None
    return Docking(
        config.place,
        staging,
        dock,
        config.estimator,
        rover=config.rover,
        described=config.described,
        undock=config.undock,
    )
