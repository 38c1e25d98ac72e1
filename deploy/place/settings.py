"""Settings of a drive to a place."""

from typing import Any

from deploy.drive.config import DriveConfig, settings_for
from deploy.place.place import Place
from rover_ncp.course.course import TICK_S
from rover_ncp.robot.description import RobotDescription
from rover_ncp.robot.profile import RoverProfile

MAX_DRIVE_S = 1800.0
"""Upper limit of a drive with all its tries."""
BLIND_S = 60.0
"""How long the rover may move by odometry alone, where poses are lost."""


def place_config(
    place: Place, rover: RoverProfile | None, described: RobotDescription | None, **more: Any
) -> DriveConfig:
    """Return the settings of a drive to a place; ``more`` are further settings."""
    about: dict[str, Any] = {
        "place": place,
        "course": place.name,
        "ticks": round(MAX_DRIVE_S / TICK_S),
        # A docked rover is where its place is, also if its poses are hidden there.
        "pose": "auto" if more.get("undock") else "required",
        "pose_age_s": BLIND_S,
        "pose_frame": place.frame,
        "estimator": settings_for(rover, described),
        "rover": rover,
        "described": described,
    }
    return DriveConfig(**about | more)
