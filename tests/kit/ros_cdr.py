"""ROS messages by an independent CDR library (pycdr2), from the published message definitions."""

import math
from dataclasses import dataclass, field

from pycdr2 import IdlStruct
from pycdr2.types import array, float32, float64, int32, sequence, uint8, uint32


@dataclass
class Time(IdlStruct):
    sec: int32 = 0
    nanosec: uint32 = 0


@dataclass
class Header(IdlStruct):
    stamp: Time = field(default_factory=Time)
    frame_id: str = ""


@dataclass
class Bool(IdlStruct):
    data: bool = False


@dataclass
class HazardDetection(IdlStruct):
    header: Header = field(default_factory=Header)
    type: uint8 = 0


@dataclass
class HazardDetectionVector(IdlStruct):
    header: Header = field(default_factory=Header)
    detections: sequence[HazardDetection] = field(default_factory=list)


@dataclass
class Vector3(IdlStruct):
    x: float64 = 0.0
    y: float64 = 0.0
    z: float64 = 0.0


@dataclass
class Quaternion(IdlStruct):
    x: float64 = 0.0
    y: float64 = 0.0
    z: float64 = 0.0
    w: float64 = 1.0


@dataclass
class Pose(IdlStruct):
    position: Vector3 = field(default_factory=Vector3)
    orientation: Quaternion = field(default_factory=Quaternion)


@dataclass
class PoseWithCovariance(IdlStruct):
    pose: Pose = field(default_factory=Pose)
    covariance: array[float64, 36] = field(default_factory=lambda: [0.0] * 36)


@dataclass
class Twist(IdlStruct):
    linear: Vector3 = field(default_factory=Vector3)
    angular: Vector3 = field(default_factory=Vector3)


@dataclass
class TwistStamped(IdlStruct):
    header: Header = field(default_factory=Header)
    twist: Twist = field(default_factory=Twist)


@dataclass
class TwistWithCovariance(IdlStruct):
    twist: Twist = field(default_factory=Twist)
    covariance: array[float64, 36] = field(default_factory=lambda: [0.0] * 36)


@dataclass
class Odometry(IdlStruct):
    header: Header = field(default_factory=Header)
    child_frame_id: str = ""
    pose: PoseWithCovariance = field(default_factory=PoseWithCovariance)
    twist: TwistWithCovariance = field(default_factory=TwistWithCovariance)


@dataclass
class Imu(IdlStruct):
    header: Header = field(default_factory=Header)
    orientation: Quaternion = field(default_factory=Quaternion)
    orientation_covariance: array[float64, 9] = field(default_factory=lambda: [0.0] * 9)
    angular_velocity: Vector3 = field(default_factory=Vector3)
    angular_velocity_covariance: array[float64, 9] = field(default_factory=lambda: [0.0] * 9)
    linear_acceleration: Vector3 = field(default_factory=Vector3)
    linear_acceleration_covariance: array[float64, 9] = field(default_factory=lambda: [0.0] * 9)


@dataclass
class BatteryState(IdlStruct):
    header: Header = field(default_factory=Header)
    voltage: float32 = 0.0
    temperature: float32 = math.nan
    current: float32 = math.nan
    charge: float32 = math.nan
    capacity: float32 = math.nan
    design_capacity: float32 = math.nan
    percentage: float32 = math.nan
    power_supply_status: uint8 = 0
    power_supply_health: uint8 = 0
    power_supply_technology: uint8 = 0
    present: bool = True
    cell_voltage: sequence[float32] = field(default_factory=list)
    cell_temperature: sequence[float32] = field(default_factory=list)
    location: str = ""
    serial_number: str = ""


@dataclass
class LaserScan(IdlStruct):
    header: Header = field(default_factory=Header)
    angle_min: float32 = 0.0
    angle_max: float32 = 0.0
    angle_increment: float32 = 0.0
    time_increment: float32 = 0.0
    scan_time: float32 = 0.0
    range_min: float32 = 0.0
    range_max: float32 = 0.0
    ranges: sequence[float32] = field(default_factory=list)
    intensities: sequence[float32] = field(default_factory=list)


@dataclass
class String(IdlStruct):
    data: str = ""


def header(stamp_s, frame):
    """Return a header; ``stamp_s`` is of any clock."""
    seconds = math.floor(stamp_s)
    return Header(Time(seconds, round((stamp_s - seconds) * 1e9) % 1_000_000_000), frame)


def twist(velocity):
    """Return a Twist's bytes."""
    return Twist(Vector3(velocity.v, 0.0, 0.0), Vector3(0.0, 0.0, velocity.omega)).serialize()


def odometry(stamp_s, x=0.0, y=0.0, theta=0.0, v=0.0, omega=0.0, frames=("odom", "base_footprint")):
    """Return an Odometry's bytes."""
    turned = Quaternion(z=math.sin(theta / 2), w=math.cos(theta / 2))
    return Odometry(
        header(stamp_s, frames[0]),
        frames[1],
        PoseWithCovariance(Pose(Vector3(x, y, 0.0), turned)),
        TwistWithCovariance(Twist(Vector3(v, 0.0, 0.0), Vector3(0.0, 0.0, omega))),
    ).serialize()
