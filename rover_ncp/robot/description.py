"""Robot description: properties of a model of robot, with their sources.

Shipped descriptions and those of users are YAML; ``based_on`` takes all that a file leaves out from another
one. A measured robot of that model is a `rover_ncp.robot.profile`.
"""

import math
from collections.abc import Mapping
from datetime import date
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from rover_ncp.core.config import StrictModel, read_yaml, validated
from rover_ncp.core.errors import ConfigError, FileError
from rover_ncp.core.files import read_text, resolve
from rover_ncp.core.geometry import Pose
from rover_ncp.robot.lasting_error import LastingError
from rover_ncp.robot.topics import Topics

_DEPTH = 4
"""Largest number of steps of `based_on` from a file."""

MAX_BASE_TIMEOUT_S = 2.5
"""Longest base timeout that counts: a Pioneer has 2 s."""

Metres = Annotated[float, Field(ge=0.001, le=5)]
Range = Annotated[float, Field(ge=0.001, le=1000)]
Degrees = Annotated[float, Field(ge=-360, le=360)]
Offset = Annotated[float, Field(ge=-5, le=5)]


class Rectangle(StrictModel):
    """An outline around the centre of rotation, bumpers included."""

    front_m: Metres
    """Distance from the centre of rotation to the front."""
    rear_m: Metres
    """Distance from the centre of rotation to the rear."""
    width_m: Metres
    """Width, side to side."""


class Circle(StrictModel):
    """A round outline; its middle is the centre of rotation."""

    radius_m: Metres
    """Radius with bumpers."""


class Wheels(StrictModel):
    """Driven wheels, all alike: two, or four with an axle distance."""

    radius_m: Metres
    """Radius of a wheel with its tyre."""
    width_m: Metres
    """Width of a tyre."""
    track_m: Metres
    """Distance between the middles of left and right wheels."""
    axles_m: float = Field(default=0.0, ge=0, le=5)
    """Distance between front and rear axle; 0 for one axle."""

    @property
    def places(self) -> list[tuple[float, float]]:
        """Positions (x, y) of the wheels on the base."""
        axles = (self.axles_m / 2, -self.axles_m / 2) if self.axles_m else (0.0,)
        return [(x, y) for x in axles for y in (self.track_m / 2, -self.track_m / 2)]


class Drive(StrictModel):
    """Differential: one axle. Skid: wheels that slip sideways in a turn."""

    kind: Literal["differential", "skid"]
    """Kind of steering; skid needs `wheels.axles_m`."""
    effective_track_m: Metres | None = None
    """Difference of wheel speeds over turn rate, as its odometry has it; None = the wheels' track."""


class DeadBand(StrictModel):
    """Speeds that are too small for the motors: the base takes a smaller command as 0 and follows others."""

    v: float = Field(default=0.0, ge=0, le=0.5)
    """Least speed command that moves the robot, m/s."""
    omega: float = Field(default=0.0, ge=0, le=2)
    """Least turn command that moves the robot, rad/s."""
    stiction: float = Field(default=0.0, ge=0, le=1)
    """Share by which a moving robot's band is narrower; a driver sends no command within the wider one."""


class Motion(StrictModel):
    """Limits in m/s, rad/s, m/s² and rad/s² that the base keeps by itself."""

    v_max: float = Field(ge=0.01, le=5)
    """Largest speed, in both directions."""
    omega_max: float = Field(ge=0.01, le=10)
    """Largest turn rate, to both sides."""
    accel: float = Field(ge=0.01, le=50)
    """Largest acceleration away from zero speed."""
    decel: float = Field(ge=0.01, le=50)
    """Largest deceleration towards zero speed."""
    alpha: float = Field(ge=0.01, le=100)
    """Largest turn acceleration away from zero."""
    alpha_decel: float = Field(ge=0.01, le=100)
    """Largest turn deceleration towards zero."""
    dead_band: DeadBand = DeadBand()
    """Commands that do not move the robot; a driver sends pulses in their place."""
    wheel_min: float = Field(default=0.0, ge=0, le=0.5)
    """Least speed of a turning wheel, m/s; a driver commands no slower wheel but 0."""
    slow_wheels: Literal["stand", "turn"] = "stand"
    """Whether a mock's wheel that is commanded slower than `wheel_min` stands, or turns at `wheel_min`."""

    @model_validator(mode="after")
    def _can_move(self) -> Self:
        for name, least, most in (
            ("dead_band.v", self.dead_band.v, self.v_max),
            ("dead_band.omega", self.dead_band.omega, self.omega_max),
            ("wheel_min", self.wheel_min, self.v_max),
        ):
            if least >= most:
                raise ValueError(f"{name} is {least:g}, expected less than the largest speed, {most:g}")
        return self


class Delays(StrictModel):
    """Times from a command's arrival at the base."""

    v_s: float = Field(ge=0, le=2)
    """Delay until the speed begins to change."""
    omega_s: float = Field(ge=0, le=2)
    """Delay until the turn rate begins to change."""


class Odometry(StrictModel):
    """Rate of the base's reports, and default errors for a robot that is not measured."""

    rate_hz: float = Field(ge=0.1, le=1000)
    """Reports per second."""
    noise_m: float = Field(default=0.0, ge=0, le=1)
    """Standard deviation of a reported x and y."""
    noise_rad: float = Field(default=0.0, ge=0, le=1)
    """Standard deviation of a reported heading."""
    heading_step_rad: float = Field(default=0.0, ge=0, le=0.1)
    """Step of the reported heading; 0: none."""
    noise_m_s: float = Field(default=0.0, ge=0, le=1)
    """Standard deviation of a reported speed."""
    noise_rad_s: float = Field(default=0.0, ge=0, le=1)
    """Standard deviation of a reported turn rate."""
    speed_mean_s: float = Field(default=0.0, ge=0, le=10)
    """Reported speeds are means over so many seconds, which a driver does not use; 0: of the moment."""
    distance_error: float = Field(ge=1e-6, lt=0.5)
    """Distances are right within ± this share; a driver without a profile expects ±4 % at least."""
    turn_error: float = Field(ge=1e-6, lt=0.5)
    """Turns are right within ± this share."""


class Gyro(StrictModel):
    """A gyro that the base publishes."""

    rate_hz: float = Field(ge=0.1, le=1000)
    """Readings per second."""
    noise_rad_s: float = Field(default=0.0, ge=0, le=1)
    """Standard deviation of a reading."""


class Scan(StrictModel):
    """A planar laser: its pose on the base, and properties of the mock's laser."""

    x_m: float = Field(ge=-2, le=2)
    """Distance ahead of the centre of rotation."""
    y_m: float = Field(default=0.0, ge=-2, le=2)
    """Distance to the left of the centre of rotation."""
    yaw_deg: float = Field(default=0.0, ge=-180, le=180)
    """Direction of its zero angle, to the left of straight ahead."""
    rate_hz: float = Field(default=5.0, ge=0.1, le=100)
    """Scans per second."""
    range_m: tuple[Range, Range] = (0.12, 3.5)
    """Smallest and largest range."""

    @model_validator(mode="after")
    def _is_ordered(self) -> Self:
        if self.range_m[0] >= self.range_m[1]:
            raise ValueError(f"range_m is {list(self.range_m)}, expected the smaller range first")
        return self


class Battery(StrictModel):
    """Voltages of the whole pack."""

    nominal_v: float = Field(ge=0.1, le=100)
    """Nominal voltage, which the mock reports."""
    min_v: float = Field(ge=0, le=100)
    """Below this voltage the gate stops the robot."""

    @model_validator(mode="after")
    def _can_drive(self) -> Self:
        if self.min_v > self.nominal_v:
            raise ValueError(
                f"min_v is {self.min_v:g}, above nominal_v {self.nominal_v:g}: it could never drive"
            )
        return self


class Sonars(StrictModel):
    """Poses of the sonars on the base, in m and degrees; the index is the sonar's number."""

    height_m: Metres
    """Height of all sonars above the ground."""
    poses_m_deg: tuple[tuple[Offset, Offset, Degrees], ...]
    """x ahead, y to the left and direction of each."""


class Arcos(StrictModel):
    """Parameters of a Pioneer, in the units of its maker's parameter files."""

    distance_mm: float = Field(ge=0.001, le=1000)
    """Per unit of XPOS and YPOS (DistConvFactor)."""
    diff_conv_factor: float = Field(ge=1e-5, le=10)
    """One over half the effective track in mm (DiffConvFactor)."""
    v_top_mm_s: int = Field(gt=0, le=10_000)
    """The firmware's highest limit of the speed."""
    omega_top_deg_s: int = Field(gt=0, le=1000)
    """The firmware's highest limit of the turn rate."""


class Source(StrictModel):
    """The origin of figures."""

    of: tuple[str, ...]
    """Paths of the figures in the file."""
    source: str = Field(min_length=1)
    """Document or address."""
    read: date
    """Date of reading."""


class RobotDescription(StrictModel):
    """One model of robot. SI units."""

    format: Literal[1] = 1
    name: str = Field(pattern=r"^[a-z0-9][a-z0-9_-]{0,63}$")
    based_on: str | None = None
    """Name of the description that gives what this one leaves out, or its path from this file's folder."""
    footprint: Rectangle | Circle
    height_m: Metres
    """Height of the robot's top above the ground."""
    mass_kg: float = Field(ge=0.01, le=2000)
    """Mass with batteries, without load."""
    wheels: Wheels
    """The driven wheels."""
    drive: Drive
    motion: Motion
    delays: Delays
    odometry: Odometry
    gyro: Gyro | None = None
    battery: Battery
    topics: Topics | None = None
    """None for a robot without ROS 2."""
    measured_base_timeout_s: float | None = Field(default=None, ge=0.01, le=MAX_BASE_TIMEOUT_S)
    """Base timeout of this very robot: `rover-ncp bridge --measure-timeout` prints it."""
    tested_on: Literal["blocks", "floor"] = "blocks"
    """Where its wheels may turn in a test: on the floor if sensors under it report lifted wheels."""
    sonars: Sonars | None = None
    """None for a robot without them."""
    scan: Scan | None = None
    """None for a robot without a laser."""
    arcos: Arcos | None = None
    """None for a robot that does not speak ARCOS."""
    lasting_error: LastingError | None = None
    """Of the external poses; None = what their source declares."""
    sources: tuple[Source, ...] = ()

    @model_validator(mode="after")
    def _is_consistent(self) -> Self:
        if (self.wheels.axles_m > 0) != (self.drive.kind == "skid"):
            raise ValueError("a skid drive needs wheels.axles_m, a differential drive has none")
        if self.topics is not None and self.topics.scan is not None and self.scan is None:
            raise ValueError("topics.scan needs the section scan: where the laser is on the base")
        return self

    @property
    def front_m(self) -> float:
        """Distance from the centre of rotation to the front of the outline."""
        return self.footprint.radius_m if isinstance(self.footprint, Circle) else self.footprint.front_m

    @property
    def rear_m(self) -> float:
        """Distance from the centre of rotation to the rear of the outline."""
        return self.footprint.radius_m if isinstance(self.footprint, Circle) else self.footprint.rear_m

    @property
    def length_m(self) -> float:
        """Length of the outline."""
        return self.front_m + self.rear_m

    @property
    def width_m(self) -> float:
        """Width of the outline; a round robot counts as a square in simulators and checks."""
        return 2 * self.footprint.radius_m if isinstance(self.footprint, Circle) else self.footprint.width_m

    @property
    def turning_radius_m(self) -> float:
        """Radius of the circle that the outline sweeps in a turn on the spot."""
        if isinstance(self.footprint, Circle):
            return self.footprint.radius_m
        return math.hypot(max(self.front_m, self.rear_m), self.width_m / 2)

    @property
    def track_m(self) -> float:
        """The track by which the base turns a turn rate into wheel speeds."""
        return self.drive.effective_track_m or self.wheels.track_m

    @property
    def half_track_m(self) -> float:
        """Half the track; half the difference of wheel speeds over it is the turn rate."""
        return self.track_m / 2 if self.arcos is None else 0.001 / self.arcos.diff_conv_factor

    @property
    def sonar_poses(self) -> list[Pose]:
        """Pose of each sonar on the base, in m and rad; the index is the sonar's number."""
        poses = () if self.sonars is None else self.sonars.poses_m_deg
        return [Pose(x, y, math.radians(deg)) for x, y, deg in poses]

    @property
    def sonar_height_m(self) -> float:
        """Height of the sonars above the ground; 0 without any."""
        return 0.0 if self.sonars is None else self.sonars.height_m


def load_description(name_or_path: str | Path) -> RobotDescription:
    """Load a shipped description by name or a file by path. Raises FileError or ConfigError."""
    data = _merged(resolve("robots", name_or_path), _DEPTH)
    return validated(data, RobotDescription, str(name_or_path))


def recorded_robot(settings: Mapping[str, Any], source: str) -> RobotDescription | None:
    """Return the robot of a recording's settings, None if they describe none. Raises ConfigError."""
    described = settings.get("described")
    return None if described is None else validated(described, RobotDescription, f"{source}, $.described")


def _merged(path: Path, depth: int) -> dict[str, Any]:
    """Return a file's data over that of the file it is based on, section by section."""
    data = read_yaml(read_text(path), str(path))
    if not isinstance(data, dict):
        raise ConfigError(str(path), [f"expected a mapping of keys, got {type(data).__name__}"])
    base = data.get("based_on")
    if base is None:
        return data
    if not isinstance(base, str):
        raise ConfigError(str(path), ["$.based_on: expected the name or the file of a description"])
    if not depth:
        problem = f"at most {_DEPTH} steps from file to file are followed: is a file based on itself?"
        raise ConfigError(str(path), [f"$.based_on: {problem}"])
    try:
        base_path = resolve("robots", base, path.parent)
    except FileError as error:
        raise ConfigError(str(path), [f"$.based_on: {error}"]) from error
    merged = _merged(base_path, depth - 1)
    merged.pop("measured_base_timeout_s", None)  # that robot was measured, not this one
    for key, value in data.items():
        known = merged.get(key)
        if isinstance(known, dict) and isinstance(value, dict) and key != "footprint":
            merged[key] = {**known, **value}
        elif key == "sources" and isinstance(known, list) and isinstance(value, list):
            merged[key] = [*value, *known]
        else:
            merged[key] = value
    return merged
