"""A ROS 2 base on a virtual clock: its connection, its robot's odometry, its events."""

import math

from bridge.base import BaseReport, Setpoint, TurnRate
from bridge.inbox import RobotMessage
from bridge.ros2.base import Ros2Base
from bridge.ros2.discovery import Announced, TokenSeen
from rover_ncp.core.geometry import Pose, Velocity
from rover_ncp.robot.description import load_description
from rover_ncp.wire import messages
from rover_ncp.wire.cdr import encode

BURGER = load_description("turtlebot3-burger")
EPOCH_S = 1.7e9
OURS = b"o" * 16


def header(stamp_s, frame="odom"):
    """Return a Header's fields; ``stamp_s`` is of any clock."""
    seconds = math.floor(stamp_s)
    return {"stamp": {"sec": seconds, "nanosec": round((stamp_s - seconds) * 1e9)}, "frame_id": frame}


def odometry(stamp_s, x=0.0, y=0.0, theta=0.0, v=0.0, omega=0.0, frames=("odom", "base_footprint")):
    """Return an Odometry's bytes."""
    stamp_ns = round(stamp_s * 1e9)
    return messages.odometry(Pose(x, y, theta), Velocity(v, omega), stamp_ns, frames=frames)


def twist(velocity):
    """Return a Twist's bytes."""
    return encode(messages.TWIST, linear={"x": velocity.v}, angular={"z": velocity.omega})


class Line:
    """A session that keeps what is sent."""

    endpoint, zid, source = "tcp/robot:7447", "ours", OURS

    def __init__(self):
        self.sent, self.closed, self.waited_s = [], False, 0.0

    def topic(self, name):
        return name

    def publish(self, payload):
        assert not self.closed
        self.sent.append(payload)

    def wait(self, seconds):
        self.waited_s += seconds

    def close(self):
        self.closed = True


class World:
    """A base, a line and a clock; ``events`` is all that happened, reports apart."""

    def __init__(self, description=BURGER):
        self.line, self.now = Line(), 100.0
        self.base = Ros2Base(self.line, description, unsafe=False)
        self.events, self.reports, self.turns = [], [], []
        self.x = self.setpoint_v = 0.0
        self.emergency, self.motors, self.lease = False, True, 1
        self.clock_s = EPOCH_S

    def keep(self, events):
        for event in events:
            kind = {BaseReport: self.reports, TurnRate: self.turns}.get(type(event), self.events)
            kind.append(event)

    def tell(self, arrival):
        self.keep(self.base.receive(arrival, self.now))

    def hear(self, topic, payload, source=None):
        self.tell(RobotMessage(topic, payload, self.now, source))

    def odom(self, source=None, **values):
        self.hear("odom", odometry(self.clock_s + self.now, **{"x": self.x, **values}), source)

    def run(self, seconds, odom=True, rate_hz=20.0, each=None, **values):
        """Let time pass in ticks of 10 ms."""
        due_s = self.now
        for _ in range(round(seconds * 100)):
            self.now += 0.01
            self.x += 0.01 * self.setpoint_v
            if odom and self.now >= due_s - 1e-9:
                due_s += 1 / rate_hz
                self.odom(**{"v": self.setpoint_v, **values})
            if each:
                each()
            setpoint = Setpoint(Velocity(self.setpoint_v, 0.0), self.motors, self.emergency, self.lease)
            self.keep(self.base.drive(setpoint, self.now))
        return self

    @property
    def last(self):
        return self.events[-1] if self.events else None

    def sent_v(self, begin=0):
        """The forward speeds of the commands, from the one numbered ``begin`` on."""
        return [messages.read_twist(data).velocity.v for data in self.line.sent[begin:]]

    @property
    def stamp_s(self):
        """The stamp of the last command."""
        return messages.read_twist(self.line.sent[-1]).stamp_ns * 1e-9


def announced(topic, ros_type, who="robot", published=True):
    return TokenSeen(Announced("theirs", published, topic, ros_type, who), True)
