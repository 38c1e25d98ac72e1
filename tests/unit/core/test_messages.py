"""ROS messages: values there and back, garbage, poses that are none."""

import math
import struct
import tracemalloc

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from rover_ncp.core.errors import FormatError
from rover_ncp.core.geometry import Pose, Velocity, wrap_angle
from rover_ncp.wire import messages
from rover_ncp.wire.cdr import encode
from rover_ncp.wire.messages import read_imu

STAMP = 1_700_000_123_456_789_012
numbers = st.floats(-1e6, 1e6)
stamps = st.integers(0, 2**31 * 10**9 - 1)


@given(x=numbers, y=numbers, theta=st.floats(-math.pi, math.pi), v=numbers, omega=numbers, stamp=stamps)
def test_odometry_comes_back(x, y, theta, v, omega, stamp):
    sample = messages.read_odometry(messages.odometry(Pose(x, y, theta), Velocity(v, omega), stamp))
    assert (sample.stamp_ns, sample.velocity) == (stamp, Velocity(v, omega))
    assert sample.pose[:2] == (x, y)
    assert abs(wrap_angle(sample.pose.theta - theta)) < 1e-12


@given(v=st.floats(), omega=st.floats(), stamp=stamps.filter(bool))
def test_a_command_comes_back_to_the_bit(v, omega, stamp):
    sample = messages.read_twist(messages.twist_stamped(Velocity(v, omega), stamp))
    assert sample.stamp_ns == stamp
    assert struct.pack("<2d", *sample.velocity) == struct.pack("<2d", v, omega)


def test_a_plain_twist_of_either_byte_order_and_an_unstamped_one_have_no_stamp():
    for header, order in ((b"\0\1\0\0", "<"), (b"\0\0\0\0", ">")):
        plain = messages.read_twist(header + struct.pack(f"{order}6d", 0.16, 0, 0, 0, 0, -0.18))
        assert plain == messages.TwistSample(Velocity(0.16, -0.18), None)
    assert messages.read_twist(messages.twist_stamped(Velocity(1.0, 2.0), 0)).stamp_ns is None


def test_a_pose_comes_back_with_its_covariance():
    covariance = np.array([[1.0, 0.1, 0.2], [0.1, 2.0, 0.3], [0.2, 0.3, 3.0]])
    sample = messages.read_pose(
        messages.pose_with_covariance(Pose(1.0, 2.0, -0.5), covariance, STAMP, "course")
    )
    assert (sample.stamp_ns, sample.frame) == (STAMP, "course")
    assert np.allclose(sample.pose, (1.0, 2.0, -0.5), atol=1e-12)
    assert np.array_equal(sample.covariance, covariance)


def test_a_length_beyond_the_bytes_costs_no_memory():
    tracemalloc.start()
    with pytest.raises(FormatError):
        messages.decode("tf2_msgs/msg/TFMessage", b"\0\1\0\0\xff\xff\xff\xff" + b"\0" * 80)
    assert tracemalloc.get_traced_memory()[1] < 4_000_000  # a code table may load, a gigabyte may not
    tracemalloc.stop()


def test_imu_without_a_gyro_is_no_gyro_that_measures_zero():
    data = encode("sensor_msgs/msg/Imu", angular_velocity_covariance=np.array([-1.0, *[0.0] * 8]))
    with pytest.raises(FormatError, match="measures no turn rate"):
        read_imu(data)


def test_pose_on_a_ramp_has_its_heading():
    turn = Rotation.from_euler("z", 0.5) * Rotation.from_euler("y", 20, degrees=True)
    pose = {"orientation": dict(zip("xyzw", turn.as_quat().tolist(), strict=True))}
    assert messages.read_pose_stamped(encode(messages.POSE_STAMPED, pose=pose)).theta == pytest.approx(0.5)
