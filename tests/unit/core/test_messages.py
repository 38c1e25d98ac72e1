"""ROS messages: bytes against an independent layout, values there and back, garbage refused."""

import math
import struct
import tracemalloc

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from rover_ncp.core import cdr, messages
from rover_ncp.core.errors import FormatError
from rover_ncp.core.geometry import Pose, Velocity, wrap_angle
from rover_ncp.core.key_table import KEYS, Kind
from rover_ncp.core.messages import imu, read_imu

STAMP = 1_700_000_123_456_789_012
STAMP_PARTS = (1_700_000_123, 456_789_012)
numbers = st.floats(-1e6, 1e6)
stamps = st.integers(0, 2**31 * 10**9 - 1)
ROS_TYPES = sorted({row.type for row in KEYS if row.kind is Kind.MESSAGE} | {"geometry_msgs/msg/Twist"})


def header(frame: str) -> bytes:
    name = frame.encode() + b"\0"
    return b"\0\1\0\0" + struct.pack("<iII", *STAMP_PARTS, len(name)) + name


def samples() -> dict[str, bytes]:
    pose, velocity = Pose(1.0, -2.0, 0.5), Velocity(0.16, -0.18)
    return {
        "nav_msgs/msg/Odometry": messages.odometry(pose, velocity, STAMP),
        "tf2_msgs/msg/TFMessage": messages.transforms(
            [messages.Transform("odom", "base_link", 1.0, 2.0, 0.0, 0.5)], STAMP
        ),
        "sensor_msgs/msg/BatteryState": messages.battery_state(12.6, STAMP),
        "sensor_msgs/msg/PointCloud2": messages.point_cloud([(1.0, 2.0, 3.0), (4.0, 5.0, 6.0)], STAMP),
        "std_msgs/msg/UInt8MultiArray": messages.bumpers(0b101, 0),
        "diagnostic_msgs/msg/DiagnosticArray": messages.diagnostics(
            [messages.Diagnostic("gate", 1, "stopped", {"reason": "silence"})], STAMP, "p3at"
        ),
        "geometry_msgs/msg/TwistStamped": messages.twist_stamped(velocity, STAMP),
        "geometry_msgs/msg/Twist": b"\0\1\0\0" + struct.pack("<6d", 0.16, 0, 0, 0, 0, -0.18),
        "sensor_msgs/msg/Imu": imu(-0.2, 1e-4, STAMP),
        "std_msgs/msg/String": messages.text("wach"),
        "geometry_msgs/msg/PoseWithCovarianceStamped": messages.pose_with_covariance(
            pose, np.eye(3), STAMP, "course"
        ),
        "std_msgs/msg/Float64MultiArray": messages.neurons([-70.0, -20.0], ["AVA", "FWD"]),
    }


def test_a_sample_stands_for_every_type_on_the_wire():
    assert sorted(samples()) == ROS_TYPES


def test_twist_stamped_has_the_bytes_that_others_send():
    expected = header("base_link") + b"\0\0" + struct.pack("<6d", 0.16, 0, 0, 0, 0, -0.18)
    assert messages.twist_stamped(Velocity(0.16, -0.18), STAMP) == expected
    assert len(expected) == 76


def test_odometry_has_the_bytes_that_others_send():
    pose, velocity = Pose(1.5, -2.25, 2.0), Velocity(0.16, -0.18)
    pose_covariance = np.diag([0.1, 0.2, 1e6, 1e6, 1e6, 0.3])
    velocity_covariance = np.diag([0.4, 0.0, 1e6, 1e6, 1e6, 0.5])
    expected = (
        header("odom")
        + b"\0\0\0"
        + struct.pack("<I", 10)
        + b"base_link\0"
        + b"\0" * 6
        + struct.pack("<7d", 1.5, -2.25, 0, 0, 0, math.sin(1.0), math.cos(1.0))
        + pose_covariance.astype("<f8").tobytes()
        + struct.pack("<6d", 0.16, 0, 0, 0, 0, -0.18)
        + velocity_covariance.astype("<f8").tobytes()
    )
    data = messages.odometry(pose, velocity, STAMP, (0.1, 0.2, 0.3), (0.4, 0.5))
    assert data == expected
    assert len(data) == 724
    assert struct.unpack_from("<3d", data, 44) == (1.5, -2.25, 0.0)
    assert struct.unpack_from("<d", data, 388) == (0.16,)
    assert struct.unpack_from("<d", data, 428) == (-0.18,)


def test_a_battery_has_the_layout_of_ros():
    data = messages.battery_state(12.5, STAMP, charge=0.75, charging=True)
    start = len(header("base_link")) + 2  # the floats are aligned to 4 behind the header
    values = struct.unpack_from("<7f3B?", data, start)
    assert values[0] == 12.5
    assert all(math.isnan(value) for value in values[1:6])
    assert values[6:] == (0.75, 1, 0, 0, True)


def test_a_point_cloud_says_where_its_floats_are():
    cloud = messages.decode("sensor_msgs/msg/PointCloud2", samples()["sensor_msgs/msg/PointCloud2"])
    assert (cloud.height, cloud.width, cloud.point_step, cloud.row_step) == (1, 2, 12, 24)
    assert [(field.name, field.offset, field.datatype) for field in cloud.fields] == [
        ("x", 0, 7),
        ("y", 4, 7),
        ("z", 8, 7),
    ]
    assert struct.unpack("<6f", cloud.data.tobytes()) == (1.0, 2.0, 3.0, 4.0, 5.0, 6.0)
    assert messages.decode("sensor_msgs/msg/PointCloud2", messages.point_cloud([], STAMP)).width == 0


@pytest.mark.parametrize(
    ("ros_type", "hash_"),
    [
        ("std_msgs/msg/String", "df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"),
        (
            "geometry_msgs/msg/TwistStamped",
            "5f0fcd4f81d5d06ad9b4c4c63e3ea51b82d6ae4d0558f1d475229b1121db6f64",
        ),
        ("nav_msgs/msg/Odometry", "3cc97dc7fb7502f8714462c526d369e35b603cfc34d946e3f2eda2766dfec6e0"),
    ],
)
def test_types_are_those_of_ros_2(ros_type, hash_):
    assert cdr.type_hash(ros_type) == f"RIHS01_{hash_}"


def test_a_definition_brings_all_that_a_type_is_made_of():
    text = cdr.definition("geometry_msgs/msg/TwistStamped")
    assert text.startswith("std_msgs/Header header\ngeometry_msgs/Twist twist\n")
    assert [line for line in text.splitlines() if line.startswith("MSG:")] == [
        "MSG: std_msgs/Header",
        "MSG: builtin_interfaces/Time",
        "MSG: geometry_msgs/Twist",
        "MSG: geometry_msgs/Vector3",
    ]


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


def test_a_plain_twist_and_an_unstamped_one_have_no_stamp():
    plain = messages.read_twist(samples()["geometry_msgs/msg/Twist"])
    assert plain == messages.TwistSample(Velocity(0.16, -0.18), None)
    assert messages.read_twist(messages.twist_stamped(Velocity(1.0, 2.0), 0)).stamp_ns is None


def test_big_endian_peers_are_understood():
    data = b"\0\0\0\0" + struct.pack(">6d", 0.16, 0, 0, 0, 0, -0.18)
    assert messages.read_twist(data).velocity == Velocity(0.16, -0.18)


def test_a_pose_comes_back_with_its_covariance():
    covariance = np.array([[1.0, 0.1, 0.2], [0.1, 2.0, 0.3], [0.2, 0.3, 3.0]])
    sample = messages.read_pose(
        messages.pose_with_covariance(Pose(1.0, 2.0, -0.5), covariance, STAMP, "course")
    )
    assert (sample.stamp_ns, sample.frame) == (STAMP, "course")
    assert np.allclose(sample.pose, (1.0, 2.0, -0.5), atol=1e-12)
    assert np.array_equal(sample.covariance, covariance)


def test_neurons_keep_their_names():
    potentials = {"AVA": -70.5, "FWD": -20.25}
    assert messages.read_neurons(messages.neurons(list(potentials.values()), list(potentials))) == potentials
    with pytest.raises(FormatError, match="2 names for 1 potentials"):
        messages.read_neurons(messages.neurons([1.0], ["A", "B"]))


def test_a_value_that_does_not_fit_is_refused_when_written():
    with pytest.raises(FormatError, match="cannot be written"):
        messages.twist_stamped(Velocity(0.0, 0.0), 2**31 * 10**9)
    with pytest.raises(FormatError, match="cannot be written"):
        messages.battery_state(1e300, STAMP)


READERS = {
    "nav_msgs/msg/Odometry": messages.read_odometry,
    "geometry_msgs/msg/TwistStamped": messages.read_twist,
    "geometry_msgs/msg/Twist": messages.read_twist,
    "geometry_msgs/msg/PoseWithCovarianceStamped": messages.read_pose,
    "std_msgs/msg/Float64MultiArray": messages.read_neurons,
    "std_msgs/msg/String": messages.read_text,
}


@st.composite
def damaged(draw):
    """A message of some type, cut, grown or with bytes changed; or bytes that never were one."""
    data = bytearray(draw(st.sampled_from(sorted(samples().items())))[1])
    match draw(st.sampled_from(["cut", "grow", "change", "anything"])):
        case "cut":
            return bytes(data[: draw(st.integers(0, len(data) - 1))])
        case "grow":
            return bytes(data) + draw(st.binary(min_size=1, max_size=64))
        case "change":
            for _ in range(draw(st.integers(1, 4))):
                # Lengths and headers stand in front; 0xFF there makes the longest strings and lists.
                place = draw(st.integers(0, min(len(data), 96) - 1))
                data[place] = draw(st.sampled_from([0, 1, 0x7F, 0x80, 0xFF]) | st.integers(0, 255))
            return bytes(data)
        case _:
            return draw(st.binary(max_size=800))


@given(ros_type=st.sampled_from(ROS_TYPES), data=damaged())
@example(ros_type="nav_msgs/msg/Odometry", data=b"")
@example(ros_type="tf2_msgs/msg/TFMessage", data=b"\0\1\0\0\xff\xff\xff\xff" + b"\0" * 80)
@example(ros_type="std_msgs/msg/String", data=b"\0\1\0\0\xff\xff\xff\x7f" + b"a" * 80)
@example(ros_type="std_msgs/msg/Float64MultiArray", data=b"\0\1\0\0\0\0\0\0\0\0\0\0\xff\xff\xff\x1f")
def test_garbage_is_a_message_or_a_format_error(ros_type, data):
    tracemalloc.start()
    for read in (lambda data: messages.decode(ros_type, data), READERS.get(ros_type, lambda _: None)):
        try:
            read(data)
        except FormatError as error:
            assert "\n" not in str(error)
    assert tracemalloc.get_traced_memory()[1] < 4_000_000  # a code table may load, a gigabyte may not
    tracemalloc.stop()


def test_longer_than_a_key_allows_is_refused_unread():
    with pytest.raises(FormatError, match="600 bytes, expected at most 512"):
        messages.read_twist(b"\0" * 600)


def test_a_gyros_rate_of_turn_says_nothing_of_anything_else():
    data = imu(-0.2, 1e-4, STAMP)
    assert read_imu(data) == (STAMP, -0.2)
    message = messages.decode("sensor_msgs/msg/Imu", data)
    assert message.header.frame_id == "base_link"
    assert message.orientation_covariance[0] == message.linear_acceleration_covariance[0] == -1.0
    assert message.angular_velocity_covariance[8] == 1e-4
