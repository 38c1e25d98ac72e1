"""Settings of a drive."""

import math
from importlib.metadata import version
from typing import Any, Literal

from pydantic import Field

from deploy.drive.safety_monitor import Timeouts
from deploy.estimator.settings import GYRO_S, EstimatorSettings
from deploy.place.place import Place
from rover_ncp.course.course import Course
from rover_ncp.robot.description import RobotDescription
from rover_ncp.robot.profile import OF_THE_GROUND, RoverProfile
from rover_ncp.wire.messages import COURSE_FRAME

STD = {
    "distance_gain": "distance_gain_std",
    "turn_gain": "turn_gain_std",
    "wheel_mismatch_rad_m": "wheel_mismatch_std_rad_m",
    "rotation_center_m": "rotation_center_std_m",
    "rotation_center_left_m": "rotation_center_left_std_m",
}
"""Odometry's errors in the estimator's settings, and their standard deviations."""
SLIDES = "downhill_x_m", "downhill_y_m"

REJECTED_S = 0.3
"""Time for which odometry may be rejected: three reports of a Pioneer."""
AXLE_STD_M = 0.002
"""How well a description knows where the axle of a differential drive is (chosen)."""
AXLE_GAIN_WALK = 0.02
"""Random change of its turn gain after a turn of 1 rad (chosen)."""
CASTER_M = 0.015
"""Random displacement after a metre: its casters push it by a centimetre as they turn (chosen)."""

PoseUse = Literal["auto", "required", "none"]
"""Whether external poses give the start pose: if they come, always, or never."""


class DriveConfig(Timeouts):
    """The settings of one drive; times in s."""

    format: int = Field(default=4, ge=4, le=4)
    version: str = Field(default_factory=lambda: version("rover-ncp"))
    robot: str
    namespace: str = ""
    policy: str
    course: str
    dry_run: bool = False
    ticks: int = Field(ge=1, description="how many control ticks the drive lasts at most")
    still_wait_s: float = Field(default=10.0, gt=0, description="for the rover to stand still")
    still_s: float = Field(default=1.0, gt=0, description="so long it stands still before the start")
    still_m: float = Field(default=0.003, gt=0, description="motion that counts as standing")
    still_rad: float = Field(default=0.005, gt=0)
    pose: PoseUse = "auto"
    pose_wait_s: float = Field(default=10.0, gt=0, description="for the first external pose, if required")
    pose_age_s: float = Field(
        default=3.0, gt=0, description="of motion without an external pose, if required"
    )
    start_m: float = Field(
        default=0.2, gt=0, description="how far from the course's start it may begin, in x and y"
    )
    start_rad: float = Field(default=0.35, gt=0, description="how far from the start's heading it may begin")
    require_certainty: bool = Field(default=False, description="whether 'parked, uncertain' is a failure")
    place: Place | None = Field(default=None, description="where to dock, in place of a course")
    undock: bool = Field(default=False, description="whether to leave the place")
    pose_frame: str = Field(default=COURSE_FRAME, description="frame_id of the external poses")
    estimator: EstimatorSettings = EstimatorSettings()
    rover: RoverProfile | None = Field(default=None, description="what was measured of this robot")
    described: RobotDescription | None = Field(default=None, description="what is known of its model")


def config_for(
    course: Course, rover: RoverProfile | None, described: RobotDescription | None, **settings: Any
) -> DriveConfig:
    """Return the settings of a drive of a whole course by a robot; ``settings`` are further ones."""
    about: dict[str, Any] = {
        "course": course.name,
        "ticks": course.ticks,
        "estimator": settings_for(rover, described),
    }
    return DriveConfig(**about | {"rover": rover, "described": described} | settings)


def settings_for(rover: RoverProfile | None, described: RobotDescription | None = None) -> EstimatorSettings:
    """Return the estimator's settings for a robot, from what was measured and described of its odometry.

    A measured value and that of an unmeasured robot are weighted by their variances; a value without a
    standard deviation is taken as it is, with that of an unmeasured robot.
    """
    default = EstimatorSettings() if described is None else _described(described)
    if rover is None:
        return default
    measured = {
        "wheel_mismatch_rad_m": (rover.imbalance_rad_m, rover.std.get("imbalance_rad_m")),
        "rotation_center_m": (rover.rotation_center_m, rover.std.get("rotation_center_m")),
        "rotation_center_left_m": (rover.rotation_center_left_m, rover.std.get("rotation_center_left_m")),
    }
    # A profile has odometry's motion over the true one, the estimator the inverse.
    for name, ratio in (("distance_gain", "odometry_distance"), ("turn_gain", "odometry_heading")):
        value, std = getattr(rover, ratio), rover.std.get(ratio)
        measured[name] = (value and 1.0 / value, value and std and std / value**2)
    known: dict[str, float] = {
        "position_m": max(default.position_m, rover.noise_m or 0.0),
        "heading_rad": max(default.heading_rad, rover.noise_rad or 0.0),
        "slip_s": (rover.slip_s or 0.0) / (rover.odometry_heading or 1.0),
    }
    # Taken as measured: an unmeasured robot's values are those of level ground.
    known |= {name: getattr(rover, name) or 0.0 for name in OF_THE_GROUND}
    slides = [std for name, std in rover.std.items() if name in SLIDES and getattr(rover, name) is not None]
    if slides:
        known["downhill_std_m"] = max(slides)
    for name, (value, std) in measured.items():
        if value is None:
            continue
        known[name], prior_std = value, getattr(default, STD[name])
        if std:
            share = prior_std**2 / (prior_std**2 + std**2)
            known[name] = share * value + (1.0 - share) * getattr(default, name)
            known[STD[name]] = math.sqrt(share) * std
    return default.model_copy(update=known)


def _described(robot: RobotDescription) -> EstimatorSettings:
    """Return the settings for an unmeasured robot, whose errors are uniform in the described ranges.

    The process noise lets its speed change by what it can change by between two reports.
    """
    default, motion, odometry = EstimatorSettings(), robot.motion, robot.odometry
    changed = {
        "position_m": max(default.position_m, odometry.noise_m),
        "heading_rad": max(
            default.heading_rad, math.hypot(odometry.noise_rad, odometry.heading_step_rad / math.sqrt(12.0))
        ),
        "speed_m_s": math.hypot(default.speed_m_s, odometry.noise_m_s),
        "turn_rad_s": math.hypot(default.turn_rad_s, odometry.noise_rad_s),
        "uses_speeds": odometry.speed_mean_s == 0.0,
        "acceleration": max(motion.accel, motion.decel) ** 2 / odometry.rate_hz,
        "angular_acceleration": max(motion.alpha, motion.alpha_decel) ** 2 / odometry.rate_hz,
        "rejected_in_a_row": max(default.rejected_in_a_row, math.ceil(REJECTED_S * odometry.rate_hz)),
        # Tyres and their air change distances by 6 %, whatever the model.
        "distance_gain_std": max(default.distance_gain_std, odometry.distance_error / math.sqrt(3.0)),
        "turn_gain_std": odometry.turn_error / math.sqrt(3.0),
    }
    if robot.gyro is not None:
        # Its readings are averaged over the time of a turn, and are read at other moments than odometry.
        noise_rad = robot.gyro.noise_rad_s * math.sqrt(GYRO_S / robot.gyro.rate_hz)
        changed["gyro_rad"] = max(default.gyro_rad, noise_rad)
    if robot.drive.kind == "differential":  # it turns about the middle of its axle, and does not slide
        names = "rotation_center_std_m", "rotation_center_left_std_m", "downhill_std_m"
        changed |= dict.fromkeys(names, AXLE_STD_M)
        changed |= {"turn_gain_walk": AXLE_GAIN_WALK, "wander_m": CASTER_M}
    return default.model_copy(update=changed)
