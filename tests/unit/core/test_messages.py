"""ROS messages: bytes against a CDR writer that shares nothing with ours, values there and back, garbage."""

import math
import struct
import tracemalloc

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from rover_ncp.core.errors import FormatError
from rover_ncp.core.geometry import ORIGIN, STANDSTILL, Pose, Velocity, wrap_angle
from rover_ncp.wire import messages
from rover_ncp.wire.cdr import encode
from rover_ncp.wire.header import _warn_of_clock
from rover_ncp.wire.messages import imu, read_imu

STAMP = 1_700_000_123_456_789_012
UNKNOWN = 1e6
numbers = st.floats(-1e6, 1e6)
stamps = st.integers(0, 2**31 * 10**9 - 1)


class Cdr:
    """Little-endian XCDR1: each number at a multiple of its size, counted from behind the header."""

    def __init__(self):
        self.data = bytearray()

    def put(self, kind, *values):
        size = struct.calcsize(f"<{kind}")
        for value in values:
            self.data += bytes(-len(self.data) % size) + struct.pack(f"<{kind}", value)
        return self

    def text(self, text):
        self.put("I", len(text.encode()) + 1)
        self.data += text.encode() + b"\0"
        return self

    def octets(self, *values):
        self.put("I", len(values))
        self.data += bytes(values)
        return self

    def header(self, frame):
        return self.put("i", 1_700_000_123).put("I", 456_789_012).text(frame)

    def vector(self, x, y, z):
        return self.put("d", x, y, z)

    def turn(self, yaw):
        return self.put("d", 0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2))

    def diagonal(self, *values):
        return self.put("d", *(values[i] if i == j else 0.0 for i in range(6) for j in range(6)))

    def done(self):
        return b"\0\1\0\0" + bytes(self.data)


def test_odometry_has_the_bytes_of_ros():
    expected = Cdr().header("odom").text("base_link").vector(1.0, 2.0, 0.0).turn(0.5)
    expected.diagonal(0.1, 0.2, UNKNOWN, UNKNOWN, UNKNOWN, 0.3)
    expected.vector(0.16, 0.0, 0.0).vector(0.0, 0.0, -0.18).diagonal(0.4, 0.0, *[UNKNOWN] * 3, 0.5)
    sent = messages.odometry(Pose(1.0, 2.0, 0.5), Velocity(0.16, -0.18), STAMP, (0.1, 0.2, 0.3), (0.4, 0.5))
    assert sent == expected.done()


def test_transforms_have_the_bytes_of_ros():
    expected = Cdr().put("I", 2)
    expected.header("odom").text("base_link").vector(1.0, 2.0, 0.0).turn(0.5)
    expected.header("base_link").text("sonar_0").vector(0.1, -0.2, 0.25).turn(-1.5)
    base = messages.Transform("odom", "base_link", 1.0, 2.0, 0.0, 0.5)
    sonar = messages.Transform("base_link", "sonar_0", 0.1, -0.2, 0.25, -1.5)
    assert messages.transforms([base, sonar], STAMP) == expected.done()


@pytest.mark.parametrize(("charging", "status"), [(None, 0), (True, 1), (False, 2)])
def test_battery_has_the_bytes_of_ros(charging, status):
    expected = Cdr().header("base_link").put("f", 12.5, *[math.nan] * 6)
    expected.put("B", status, 0, 0, True).put("I", 0, 0).text("").text("")
    assert messages.battery_state(12.5, STAMP, charging) == expected.done()


def test_sonar_has_the_bytes_of_ros():
    points = [(0.25, 1.0, 0.5), (-2.0, 0.125, 0.5)]
    expected = Cdr().header("base_link").put("I", 1, 2, 3)
    for offset, name in enumerate("xyz"):
        expected.text(name).put("I", 4 * offset).put("B", 7).put("I", 1)
    octets = struct.pack("<6f", *points[0], *points[1])
    expected.put("B", False).put("I", 12, 24).octets(*octets).put("B", True)
    assert messages.point_cloud(points, STAMP) == expected.done()


def test_hazards_have_the_bytes_of_ros():
    expected = Cdr().header("base_link").put("I", 2)
    expected.header("base_link").put("B", 1).header("base_link").put("B", 3)
    assert messages.hazards([1, 3], STAMP) == expected.done()
    assert messages.read_hazards(expected.done()) == {1, 3}


def test_diagnostics_have_the_bytes_of_ros():
    expected = Cdr().header("base_link").put("I", 1)
    expected.put("B", 1).text("bridge: gate").text("silence").text("Pioneer p3at-sh")
    expected.put("I", 2).text("driver").text("ros").text("accepted").text("3")
    item = messages.Diagnostic("bridge: gate", 1, "silence", {"driver": "ros", "accepted": "3"})
    assert messages.diagnostics([item], STAMP, "Pioneer p3at-sh") == expected.done()


def test_command_status_and_bumpers_have_the_bytes_of_ros():
    expected = Cdr().header("base_link").vector(0.16, 0.0, 0.0).vector(0.0, 0.0, -0.18)
    assert messages.twist_stamped(Velocity(0.16, -0.18), STAMP) == expected.done()
    assert messages.text('{"held":""}') == Cdr().text('{"held":""}').done()
    expected = Cdr().put("I", 1).text("front,rear").put("I", 2, 2).put("I", 0).octets(0b101, 0b10)
    assert messages.bumpers(0b101, 0b10) == expected.done()


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


def test_neurons_keep_their_names():
    potentials = {"AVA": -70.5, "FWD": -20.25}
    assert messages.read_neurons(messages.neurons(list(potentials.values()), list(potentials))) == potentials
    with pytest.raises(FormatError, match="2 names for 1 potentials"):
        messages.read_neurons(messages.neurons([1.0], ["A", "B"]))


@pytest.mark.parametrize("stamp_ns", [2**31 * 10**9, 2**63 - 1, -(2**31) * 10**9 - 1])
def test_a_stamp_that_ros_cannot_hold_is_sent_as_none_with_one_warning(stamp_ns, caplog):
    _warn_of_clock.cache_clear()
    for _ in range(2):
        assert messages.read_odometry(messages.odometry(ORIGIN, STANDSTILL, stamp_ns)).stamp_ns == 0
    assert len(caplog.messages) == 1


def test_a_value_that_does_not_fit_is_refused_when_written():
    with pytest.raises(FormatError, match="cannot be written"):
        messages.battery_state(1e300, STAMP)


HOSTILE_LENGTHS = {
    "tf2_msgs/msg/TFMessage": b"\0\1\0\0\xff\xff\xff\xff" + b"\0" * 80,
    "std_msgs/msg/String": b"\0\1\0\0\xff\xff\xff\x7f" + b"a" * 80,
    "std_msgs/msg/Float64MultiArray": b"\0\1\0\0\0\0\0\0\0\0\0\0\xff\xff\xff\x1f",
}


@pytest.mark.parametrize("ros_type", HOSTILE_LENGTHS)
def test_a_length_beyond_the_bytes_costs_no_memory(ros_type):
    tracemalloc.start()
    with pytest.raises(FormatError):
        messages.decode(ros_type, HOSTILE_LENGTHS[ros_type])
    assert tracemalloc.get_traced_memory()[1] < 4_000_000  # a code table may load, a gigabyte may not
    tracemalloc.stop()


def test_longer_than_a_key_allows_is_refused_unread():
    with pytest.raises(FormatError, match="600 bytes, expected at most 512"):
        messages.read_twist(b"\0" * 600)


def test_a_gyros_rate_of_turn_says_nothing_of_anything_else():
    data = imu(-0.2, 1e-4, STAMP)
    assert read_imu(data) == (STAMP, -0.2)
    message = messages.decode("sensor_msgs/msg/Imu", data)
    assert (message.header.frame_id, message.angular_velocity_covariance[8]) == ("base_link", 1e-4)
    assert message.orientation_covariance[0] == message.linear_acceleration_covariance[0] == -1.0


@pytest.mark.parametrize("heading", [0.0, 0.5, 3.0])
def test_pose_with_y_up_is_refused(heading):
    """As a motion capture sends it whose vertical axis is y: all headings looked like 0 or half a turn."""
    turn = Rotation.from_euler("x", -90, degrees=True) * Rotation.from_euler("z", heading)
    pose = {"orientation": dict(zip("xyzw", turn.as_quat().tolist(), strict=True))}
    data = encode(messages.POSE_STAMPED, pose=pose)
    with pytest.raises(FormatError, match="lies on its side: its z axis is 90° from vertical"):
        messages.read_pose(messages.with_covariance(data))


def test_pose_on_a_ramp_has_its_heading():
    turn = Rotation.from_euler("z", 0.5) * Rotation.from_euler("y", 20, degrees=True)
    pose = {"orientation": dict(zip("xyzw", turn.as_quat().tolist(), strict=True))}
    assert messages.read_pose_stamped(encode(messages.POSE_STAMPED, pose=pose)).theta == pytest.approx(0.5)
