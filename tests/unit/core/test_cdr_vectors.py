"""Each message of the bridge, byte by byte, against a CDR writer that shares nothing with ours."""

import math
import struct

from rover_ncp.core import messages
from rover_ncp.core.geometry import Pose, Velocity

STAMP = 1_700_000_123_456_789_012
UNKNOWN = 1e6


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


def test_odometry():
    expected = Cdr().header("odom").text("base_link").vector(1.0, 2.0, 0.0).turn(0.5)
    expected.diagonal(0.1, 0.2, UNKNOWN, UNKNOWN, UNKNOWN, 0.3)
    expected.vector(0.16, 0.0, 0.0).vector(0.0, 0.0, -0.18).diagonal(0.4, 0.0, *[UNKNOWN] * 3, 0.5)
    sent = messages.odometry(Pose(1.0, 2.0, 0.5), Velocity(0.16, -0.18), STAMP, (0.1, 0.2, 0.3), (0.4, 0.5))
    assert sent == expected.done()


def test_transforms():
    expected = Cdr().put("I", 2)
    expected.header("odom").text("base_link").vector(1.0, 2.0, 0.0).turn(0.5)
    expected.header("base_link").text("sonar_0").vector(0.1, -0.2, 0.25).turn(-1.5)
    items = [
        messages.Transform("odom", "base_link", 1.0, 2.0, 0.0, 0.5),
        messages.Transform("base_link", "sonar_0", 0.1, -0.2, 0.25, -1.5),
    ]
    assert messages.transforms(items, STAMP) == expected.done()


def test_battery():
    nan = math.nan
    expected = Cdr().header("base_link").put("f", 12.5, nan, nan, nan, nan, nan, nan).put("B", 2, 0, 0, True)
    expected.put("I", 0, 0).text("").text("")
    assert messages.battery_state(12.5, STAMP, charging=False) == expected.done()


def test_sonar():
    points = [(0.25, 1.0, 0.5), (-2.0, 0.125, 0.5)]
    expected = Cdr().header("base_link").put("I", 1, 2, 3)
    for offset, name in enumerate("xyz"):
        expected.text(name).put("I", 4 * offset).put("B", 7).put("I", 1)
    expected.put("B", False).put("I", 12, 24).octets(*struct.pack("<6f", *points[0], *points[1])).put(
        "B", True
    )
    assert messages.point_cloud(points, STAMP) == expected.done()


def test_bumpers():
    expected = Cdr().put("I", 1).text("front,rear").put("I", 2, 2).put("I", 0).octets(0b101, 0b10)
    assert messages.bumpers(0b101, 0b10) == expected.done()


def test_diagnostics():
    expected = Cdr().header("base_link").put("I", 1)
    expected.put("B", 1).text("bridge: gate").text("silence").text("Pioneer p3at-sh")
    expected.put("I", 2).text("driver").text("ros").text("accepted").text("3")
    item = messages.Diagnostic("bridge: gate", 1, "silence", {"driver": "ros", "accepted": "3"})
    assert messages.diagnostics([item], STAMP, "Pioneer p3at-sh") == expected.done()


def test_command_and_status():
    expected = Cdr().header("base_link").vector(0.16, 0.0, 0.0).vector(0.0, 0.0, -0.18)
    assert messages.twist_stamped(Velocity(0.16, -0.18), STAMP) == expected.done()
    assert messages.text('{"held":""}') == Cdr().text('{"held":""}').done()
