"""The ROS messages that this project sends and reads, made from and turned into plain values.

Frames as in REP-105: ``odom`` → ``base_link``, and ``course`` for a course's own; x forward, y left, angles
counter-clockwise (REP-103). Stamps are ns since the epoch. `rover_ncp.wire.key_table` has the keys,
`rover_ncp.wire.protocol` the tags of commands and the JSON of queries, `rover_ncp.wire.cdr` the bytes.
"""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rover_ncp.core.errors import FormatError
from rover_ncp.core.geometry import Pose, Velocity
from rover_ncp.wire.cdr import decode, encode
from rover_ncp.wire.message_parts import header_of, pose_of, read_planar_pose, read_stamp_ns, rotation_of

FloatArray = NDArray[np.float64]

ODOM_FRAME = "odom"
BASE_FRAME = "base_link"
COURSE_FRAME = "course"
ODOMETRY = "nav_msgs/msg/Odometry"
TWIST = "geometry_msgs/msg/Twist"
TWIST_STAMPED = "geometry_msgs/msg/TwistStamped"
POSE_STAMPED = "geometry_msgs/msg/PoseStamped"
POSE_WITH_COVARIANCE = "geometry_msgs/msg/PoseWithCovarianceStamped"
STRING = "std_msgs/msg/String"
_BYTES = "std_msgs/msg/UInt8MultiArray"
FLOATS = "std_msgs/msg/Float64MultiArray"
IMU = "sensor_msgs/msg/Imu"
BATTERY_STATE = "sensor_msgs/msg/BatteryState"
BOOL = "std_msgs/msg/Bool"
HAZARDS = "irobot_create_msgs/msg/HazardDetectionVector"
DOCKED_TYPES = {"data": BOOL, "is_docked": "irobot_create_msgs/msg/DockStatus"}
"""The type of a topic that says whether the robot is docked, by the field that says so."""
BUMP, CLIFF, STALL, WHEEL_DROP = 1, 2, 3, 4  # of its hazards, those that stop a robot
LASER_SCAN = "sensor_msgs/msg/LaserScan"
TF = "tf2_msgs/msg/TFMessage"

WITH_COVARIANCE_BYTES = 4 + 12 + 56 + 288
"""Length of a PoseWithCovarianceStamped with an empty frame, at least; a PoseStamped is shorter."""
TWIST_BYTES = 52
"""A Twist is six float64 behind the CDR header; a TwistStamped is always longer."""
# Planar measurements say nothing of z, roll and pitch: REP convention is a large variance there.
_UNKNOWN = 1e6
_PLANAR = (0, 1, 5)
"""Rows of x, y and yaw in ROS's 6 × 6 covariances."""
# REP-145: a first element of -1 means that there is no such measurement.
_NONE = np.array([-1.0, *[0.0] * 8])
GYRO_GAP_S = 0.25
"""The turn between two rates of turn that are farther apart is not known."""


class OdometrySample(NamedTuple):
    """An Odometry as plain values, which may be not finite."""

    stamp_ns: int
    pose: Pose
    velocity: Velocity
    frame: str = ODOM_FRAME
    child: str = BASE_FRAME


class TwistSample(NamedTuple):
    """A velocity command; ``stamp_ns`` is None for a Twist, and for a TwistStamped that left it zero."""

    velocity: Velocity
    stamp_ns: int | None


class TurnSample(NamedTuple):
    """A rate of turn in rad/s, counter-clockwise; it may be not finite."""

    stamp_ns: int
    rate: float


class BatterySample(NamedTuple):
    """Voltage, which may be not finite, and whether it charges; None = not known."""

    stamp_ns: int
    voltage: float
    charging: bool | None


class PoseSample(NamedTuple):
    """A pose with its 3 × 3 covariance (x, y, theta; m², m·rad, rad²)."""

    stamp_ns: int
    frame: str
    pose: Pose
    covariance: FloatArray


class Transform(NamedTuple):
    """Pose of ``child`` in ``parent``: x, y, z in m and yaw in rad."""

    parent: str
    child: str
    x: float
    y: float
    z: float
    yaw: float


def odometry(
    pose: Pose,
    velocity: Velocity,
    stamp_ns: int,
    pose_variance: Sequence[float] = (0.0, 0.0, 0.0),
    velocity_variance: Sequence[float] = (0.0, 0.0),
    *,
    lateral_variance: float = 0.0,
    frames: tuple[str, str] = (ODOM_FRAME, BASE_FRAME),
) -> bytes:
    """Return an Odometry, base_link in odom.

    The variances are those of (x, y, theta), of (v, omega) and of the speed to the side, SI squared.
    """
    x, y, theta = pose_variance
    v, omega = velocity_variance
    return encode(
        ODOMETRY,
        header=header_of(stamp_ns, frames[0]),
        child_frame_id=frames[1],
        pose={"pose": pose_of(pose), "covariance": _diagonal(x, y, *[_UNKNOWN] * 3, theta)},
        twist={
            "twist": _twist(velocity),
            "covariance": _diagonal(v, lateral_variance, *[_UNKNOWN] * 3, omega),
        },
    )


def _diagonal(*variances: float) -> FloatArray:
    """Return the rows of a diagonal matrix, one after another; `np.diag` takes four times as long."""
    size = len(variances)
    rows = np.zeros(size * size)
    rows[:: size + 1] = variances
    return rows


def read_odometry(data: bytes) -> OdometrySample:
    """Read an Odometry. Raises FormatError."""
    message = decode(ODOMETRY, data)
    twist = message.twist.twist
    return OdometrySample(
        read_stamp_ns(message.header),
        read_planar_pose(message.pose.pose),
        Velocity(twist.linear.x, twist.angular.z),
        message.header.frame_id,
        message.child_frame_id,
    )


def twist_stamped(velocity: Velocity, stamp_ns: int) -> bytes:
    """Return a TwistStamped in base_link."""
    return encode(TWIST_STAMPED, header=header_of(stamp_ns, BASE_FRAME), twist=_twist(velocity))


def read_twist(data: bytes) -> TwistSample:
    """Read a Twist or a TwistStamped, which differ in length. Raises FormatError.

    Only linear.x and angular.z are used: the base moves neither sideways nor vertically.
    """
    if len(data) <= TWIST_BYTES:
        twist, stamp_ns = decode(TWIST, data), None
    else:
        message = decode(TWIST_STAMPED, data, max_bytes=512)
        twist, stamp_ns = message.twist, read_stamp_ns(message.header) or None
    return TwistSample(Velocity(twist.linear.x, twist.angular.z), stamp_ns)


def pose_stamped(pose: Pose, stamp_ns: int, frame: str) -> bytes:
    """Return a PoseStamped, which viewers draw (they do not draw Odometry)."""
    return encode(POSE_STAMPED, header=header_of(stamp_ns, frame), pose=pose_of(pose))


def read_pose_stamped(data: bytes) -> Pose:
    """Read a PoseStamped. Raises FormatError."""
    return read_planar_pose(decode(POSE_STAMPED, data).pose)


def path(poses: Sequence[Pose], stamp_ns: int, frame: str) -> bytes:
    """Return a Path through poses, all with one stamp."""
    header = header_of(stamp_ns, frame)
    stamped = [{"header": header, "pose": pose_of(pose)} for pose in poses]
    return encode("nav_msgs/msg/Path", header=header, poses=stamped)


def pose_with_covariance(pose: Pose, covariance: FloatArray, stamp_ns: int, frame: str) -> bytes:
    """Return a PoseWithCovarianceStamped; ``covariance`` is 3 × 3 of (x, y, theta)."""
    full = np.diag([0.0, 0.0, *[_UNKNOWN] * 3, 0.0])
    full[np.ix_(_PLANAR, _PLANAR)] = covariance
    return encode(
        POSE_WITH_COVARIANCE,
        header=header_of(stamp_ns, frame),
        pose={"pose": pose_of(pose), "covariance": full.ravel()},
    )


def with_covariance(data: bytes) -> bytes:
    """Return an external pose as a PoseWithCovarianceStamped; a PoseStamped gets variances of 0: not known.

    The two types differ in their length. Anything else is returned as it is.
    """
    if len(data) >= WITH_COVARIANCE_BYTES:
        return data
    try:
        decode(POSE_STAMPED, data)
    except FormatError:
        return data
    number = "<f8" if data[1] == 1 else ">f8"  # the CDR header tells the byte order
    return data + np.diag([0.0, 0.0, *[_UNKNOWN] * 3, 0.0]).astype(number).tobytes()


def read_pose(data: bytes) -> PoseSample:
    """Read a PoseWithCovarianceStamped. Raises FormatError."""
    message = decode(POSE_WITH_COVARIANCE, data)
    full = np.asarray(message.pose.covariance, dtype=np.float64).reshape(6, 6)
    return PoseSample(
        read_stamp_ns(message.header),
        message.header.frame_id,
        read_planar_pose(message.pose.pose),
        full[np.ix_(_PLANAR, _PLANAR)],
    )


def laser_scan(ranges: FloatArray, range_limits: tuple[float, float], stamp_ns: int) -> bytes:
    """Return a LaserScan of a whole turn, the first beam ahead; infinite ranges met nothing."""
    return encode(
        LASER_SCAN,
        header=header_of(stamp_ns, "base_scan"),
        angle_max=math.tau * (len(ranges) - 1) / len(ranges),
        angle_increment=math.tau / len(ranges),
        range_min=range_limits[0],
        range_max=range_limits[1],
        ranges=np.asarray(ranges, np.float32),
    )


def transforms(items: Sequence[Transform], stamp_ns: int) -> bytes:
    """Return a TFMessage."""
    stamped = [
        {
            "header": header_of(stamp_ns, item.parent),
            "child_frame_id": item.child,
            "transform": {
                "translation": {"x": item.x, "y": item.y, "z": item.z},
                "rotation": rotation_of(item.yaw),
            },
        }
        for item in items
    ]
    return encode(TF, transforms=stamped)


def imu(rate: float, variance: float, stamp_ns: int) -> bytes:
    """Return an Imu in base_link whose only measurement is the rate of turn; variance in (rad/s)²."""
    return encode(
        IMU,
        header=header_of(stamp_ns, BASE_FRAME),
        orientation=rotation_of(0.0),
        orientation_covariance=_NONE,
        angular_velocity={"z": rate},
        angular_velocity_covariance=_diagonal(_UNKNOWN, _UNKNOWN, variance),
        linear_acceleration_covariance=_NONE,
    )


def read_imu(data: bytes) -> TurnSample:
    """Read the rate of turn of an Imu. Raises FormatError, also for an Imu that says it measures none."""
    imu = decode(IMU, data)
    if imu.angular_velocity_covariance[0] == -1.0:  # as sensor_msgs/Imu defines it
        raise FormatError("angular_velocity_covariance begins with -1: this Imu measures no turn rate")
    return TurnSample(read_stamp_ns(imu.header), imu.angular_velocity.z)


def battery_state(voltage: float, stamp_ns: int, charging: bool | None = None) -> bytes:
    """Return a BatteryState of a lead-acid pack; a voltage of 0 and ``charging`` None are not known."""
    unknown = ("temperature", "current", "charge", "capacity", "design_capacity", "percentage")
    return encode(
        BATTERY_STATE,
        header=header_of(stamp_ns, BASE_FRAME),
        voltage=voltage or math.nan,
        **dict.fromkeys(unknown, math.nan),
        power_supply_status=0 if charging is None else 1 if charging else 2,
        power_supply_technology=0,  # ROS's list has no lead-acid
        present=voltage > 0.0,
    )


def read_battery(data: bytes) -> BatterySample:
    """Read a BatteryState; one of status 4, full, may be on a charger or not. Raises FormatError."""
    message = decode(BATTERY_STATE, data)
    charging = {0: None, 1: True, 4: None}.get(message.power_supply_status, False)
    return BatterySample(read_stamp_ns(message.header), float(message.voltage), charging)


def hazards(kinds: Sequence[int], stamp_ns: int) -> bytes:
    """Return a HazardDetectionVector."""
    head = header_of(stamp_ns, BASE_FRAME)
    return encode(HAZARDS, header=head, detections=[{"header": head, "type": kind} for kind in kinds])


def read_hazards(data: bytes) -> tuple[frozenset[int], int]:
    """Read the kinds and the stamp (ns) of a HazardDetectionVector. Raises FormatError."""
    message = decode(HAZARDS, data)
    return frozenset(int(found.type) for found in message.detections), read_stamp_ns(message.header)


def boolean(value: bool) -> bytes:
    """Return a Bool."""
    return encode(BOOL, data=value)


def read_docked(data: bytes, field: str = "data") -> tuple[bool, int]:
    """Read whether the robot is docked, by a field of a message, and its stamp (ns). Raises FormatError.

    The stamp is 0 where the type has none.
    """
    message = decode(DOCKED_TYPES[field], data)
    stamp_ns = read_stamp_ns(message.header) if hasattr(message, "header") else 0
    return bool(getattr(message, field)), stamp_ns


def point_cloud(points: Sequence[tuple[float, float, float]], stamp_ns: int) -> bytes:
    """Return a PointCloud2 in base_link of x, y, z in metres as float32."""
    cloud = np.asarray(points, dtype="<f4").reshape(-1, 3)
    return encode(
        "sensor_msgs/msg/PointCloud2",
        header=header_of(stamp_ns, BASE_FRAME),
        height=1,
        width=len(cloud),
        fields=[{"name": name, "offset": 4 * i, "datatype": 7, "count": 1} for i, name in enumerate("xyz")],
        point_step=12,
        row_step=12 * len(cloud),
        data=np.frombuffer(cloud.tobytes(), np.uint8),
        is_dense=True,
    )


def read_points(data: bytes) -> FloatArray:
    """Return x, y, z of the points of a cloud as `point_cloud` makes it, n × 3. Raises FormatError."""
    message = decode("sensor_msgs/msg/PointCloud2", data)
    content = bytes(message.data)
    if message.point_step != 12 or len(content) % 12:
        raise FormatError(f"a cloud with points of {message.point_step} bytes, expected x, y, z as float32")
    return np.frombuffer(content, "<f4").reshape(-1, 3).astype(np.float64)


def bumpers(front: int, rear: int) -> bytes:
    """Return the bumper bits as two bytes, front and rear; bit 0 is the first segment, 1 = pressed."""
    return encode(_BYTES, layout=_layout("front,rear", 2), data=np.array([front, rear], np.uint8))


def read_bumpers(data: bytes) -> tuple[bool, bool]:
    """Return whether the front bumper is pressed, and the rear one. Raises FormatError."""
    pressed = decode(_BYTES, data).data > 0
    return bool(pressed[:1].any()), bool(pressed[1:].any())


def neurons(potentials: Sequence[float] | FloatArray, names: Sequence[str]) -> bytes:
    """Return potentials in mV as a Float64MultiArray whose label is the names, joined by commas."""
    layout = _layout(",".join(names), len(potentials))
    return encode(FLOATS, layout=layout, data=np.asarray(potentials, np.float64))


def read_neurons(data: bytes) -> dict[str, float]:
    """Read what `neurons` wrote. Raises FormatError."""
    message = decode(FLOATS, data)
    names = message.layout.dim[0].label.split(",") if message.layout.dim else []
    if len(names) != len(message.data):
        raise FormatError(f"neurons: {len(names)} names for {len(message.data)} potentials")
    return dict(zip(names, (float(value) for value in message.data), strict=True))


def text(content: str) -> bytes:
    """Return a String, which carries the JSON of the status keys."""
    return encode(STRING, data=content)


def read_text(data: bytes) -> str:
    """Read a String. Raises FormatError."""
    return str(decode(STRING, data).data)


def _twist(velocity: Velocity) -> dict[str, Any]:
    return {"linear": {"x": velocity.v}, "angular": {"z": velocity.omega}}


def _layout(label: str, size: int) -> dict[str, Any]:
    return {"dim": [{"label": label, "size": size, "stride": size}]}
