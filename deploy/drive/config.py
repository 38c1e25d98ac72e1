"""Settings of a drive."""

import math
from importlib.metadata import version
from typing import Any, Literal

from pydantic import Field

from deploy.drive.safety_monitor import Timeouts
from deploy.estimator.settings import GYRO_S, EstimatorSettings
from deploy.place.place import Place
from deploy.place.sight import Sight
from rover_ncp.course.course import TICK_S, Course
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
"""The values of a profile that share one standard deviation in the estimator's settings, `downhill_std_m`."""

REJECTED_S = 0.3
"""Time for which odometry may be rejected: three reports of a Pioneer."""
AXLE_STD_M = 0.002
"""Standard deviation of the position of a differential drive's axle in its description, m (chosen)."""
AXLE_SLIDE_STD_M = 0.002
"""Standard deviation of a differential drive's slide on a slope, m per radian of turn (chosen)."""
AXLE_GAIN_WALK = 0.02
"""Random change of a differential drive's turn gain after a turn of 1 rad (chosen)."""
CASTER_M = 0.015
"""Random displacement of a differential drive after a metre: its casters push it as they turn (chosen)."""

MOUNT_STD_RAD = 0.03
"""Standard deviation of the constant heading error of a localiser, such as a camera's yaw (chosen)."""

MAX_DRIVE_S = 1800.0
"""Upper limit of a drive with all its tries."""
BLIND_S = 60.0
"""How long the rover may move by odometry alone, where poses are lost."""

PoseUse = Literal["auto", "required", "none"]
"""Whether external poses give the start pose: if they come, always, or never."""


class DriveConfig(Timeouts):
    """The settings of one drive; times in s."""

    format: Literal[5] = 5
    version: str = Field(default_factory=lambda: version("rover-ncp"))
    robot: str
    namespace: str = ""
    policy: str
    course: str
    dry_run: bool = False
    ticks: int = Field(ge=1, description="how many control ticks the drive lasts at most")
    still_wait_s: float = Field(default=10.0, gt=0, description="longest wait for a standstill")
    still_s: float = Field(default=1.0, gt=0, description="time at a standstill before the start")
    still_m: float = Field(default=0.003, gt=0, description="largest motion that counts as standstill (m)")
    still_rad: float = Field(default=0.005, gt=0, description="largest turn that counts as standstill (rad)")
    pose: PoseUse = "auto"
    pose_wait_s: float = Field(
        default=10.0, gt=0, description="longest wait for the first external pose, if required"
    )
    pose_age_s: float = Field(
        default=3.0, gt=0, description="longest motion without an external pose, if required"
    )
    start_m: float = Field(
        default=0.3, gt=0, description="largest distance from the course's start, per axis (m)"
    )
    start_rad: float = Field(default=0.35, gt=0, description="largest turn from the start's heading (rad)")
    require_certainty: bool = Field(default=False, description="whether 'parked, uncertain' is a failure")
    place: Place | None = Field(default=None, description="where to dock, in place of a course")
    sight: Sight | None = Field(
        default=None, description="the localiser's camera and the tags of the place, if they are known"
    )
    undock: bool = Field(default=False, description="whether to leave the place")
    pose_frame: str = Field(default=COURSE_FRAME, description="frame_id of the external poses")
    estimator: EstimatorSettings = EstimatorSettings()
    rover: RoverProfile | None = Field(default=None, description="robot profile")
    described: RobotDescription | None = Field(default=None, description="robot description")


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
        "estimator": settings_for(rover, described).model_copy(update={"mount_std_rad": MOUNT_STD_RAD}),
        "rover": rover,
        "described": described,
    }
    return DriveConfig(**about | more)


def settings_for(rover: RoverProfile | None, described: RobotDescription | None = None) -> EstimatorSettings:
    """Return the estimator's settings for a robot, from its profile and its description.

    The prior is that of an unmeasured robot. The measured value and the prior are averaged with
    inverse-variance weights. Without a standard deviation the measured value is used and the prior's standard
    deviation kept.
    """
    default = EstimatorSettings() if described is None else _described(described)
    if rover is None:
        return default
    measured: dict[str, tuple[float | None, float | None]] = {
        "wheel_mismatch_rad_m": (rover.wheel_mismatch_rad_m, rover.std.get("wheel_mismatch_rad_m")),
        "rotation_center_m": (rover.rotation_center_m, rover.std.get("rotation_center_m")),
        "rotation_center_left_m": (rover.rotation_center_left_m, rover.std.get("rotation_center_left_m")),
    }
    # A profile has odometry's motion over the true one, the estimator the inverse.
    for name, ratio in (("distance_gain", "odometry_distance"), ("turn_gain", "odometry_heading")):
        value, std = getattr(rover, ratio), rover.std.get(ratio)
        if value is not None:
            measured[name] = 1.0 / value, None if std is None else std / value**2
    known: dict[str, float] = {
        "position_m": max(default.position_m, rover.noise_m or 0.0),
        "heading_rad": max(default.heading_rad, rover.noise_rad or 0.0),
        # A profile has the slipped share per true rad/s, the estimator per rad/s of odometry.
        "slip_s": (rover.slip_s or 0.0) / (rover.odometry_heading or 1.0),
    }
    # Not averaged: the prior is level ground.
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

    Process noise lets the speed change by the maximum acceleration times one report interval.
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
        # The default, ±4 %, is for tyres, their air and slopes, whatever the model.
        "distance_gain_std": max(default.distance_gain_std, odometry.distance_error / math.sqrt(3.0)),
        # The default is for skid steering: a differential drive's turns are truer.
        "turn_gain_std": odometry.turn_error / math.sqrt(3.0),
        "half_track_m": robot.track_m / 2.0,
        "half_wheelbase_m": robot.wheels.axles_m / 2.0,
    }
    if robot.gyro is not None:
        # The gyro's readings in GYRO_S are added, with independent noise. The default is a minimum, as the
        # gyro is read at other moments than odometry.
        noise_rad = robot.gyro.noise_rad_s * math.sqrt(GYRO_S / robot.gyro.rate_hz)
        changed["gyro_rad"] = max(default.gyro_rad, noise_rad)
    if robot.drive.kind == "differential":  # it turns about the middle of its axle, and does not slide
        changed |= dict.fromkeys(("rotation_center_std_m", "rotation_center_left_std_m"), AXLE_STD_M)
        changed |= {
            "downhill_std_m": AXLE_SLIDE_STD_M,
            "turn_gain_walk": AXLE_GAIN_WALK,
            "wander_m": CASTER_M,
        }
    return default.model_copy(update=changed)
