"""A gyro's rate of turn as sensor_msgs/Imu in base_link. Orientation and acceleration are not given."""

from typing import NamedTuple

import numpy as np

from rover_ncp.core.cdr import decode, encode, make
from rover_ncp.core.messages import BASE_FRAME

IMU = "sensor_msgs/msg/Imu"
_SECOND_NS = 1_000_000_000
_UNKNOWN = 1e6
# REP-145: a first element of -1 means that there is no such measurement.
_NONE = np.array([-1.0, *[0.0] * 8])


class TurnSample(NamedTuple):
    """A rate of turn in rad/s, counter-clockwise; it may be not finite."""

    stamp_ns: int
    rate: float


def imu(rate: float, variance: float, stamp_ns: int) -> bytes:
    """Return an Imu whose only measurement is the rate of turn, with its variance in (rad/s)²."""
    seconds, nanoseconds = divmod(stamp_ns, _SECOND_NS)
    zero = make("geometry_msgs/msg/Vector3", x=0.0, y=0.0, z=0.0)
    return encode(
        make(
            IMU,
            header=make(
                "std_msgs/msg/Header",
                stamp=make("builtin_interfaces/msg/Time", sec=seconds, nanosec=nanoseconds),
                frame_id=BASE_FRAME,
            ),
            orientation=make("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=0.0, w=1.0),
            orientation_covariance=_NONE,
            angular_velocity=make("geometry_msgs/msg/Vector3", x=0.0, y=0.0, z=rate),
            angular_velocity_covariance=np.diag([_UNKNOWN, _UNKNOWN, variance]).ravel(),
            linear_acceleration=zero,
            linear_acceleration_covariance=_NONE,
        )
    )


def read_imu(data: bytes) -> TurnSample:
    """Read the rate of turn of an Imu. Raises FormatError."""
    message = decode(IMU, data)
    stamp = message.header.stamp
    return TurnSample(int(stamp.sec) * _SECOND_NS + int(stamp.nanosec), message.angular_velocity.z)
