"""Simulated robots, and the lines between them and the bridge's base, on a virtual clock.

A line carries the bytes or messages of the real one. Time is that of the last ``advance``.
"""

from dataclasses import replace

from bridge.bases import gate_limits
from bridge.gate.limits import Limits
from bridge.inbox import RobotMessage
from bridge.pioneer.base import ArcosBase
from bridge.pioneer.base_connection import Opened, Received
from bridge.pioneer.session import Session
from bridge.pioneer.setpoints import MotionLimits
from bridge.ros2.base import Ros2Base
from rover_ncp.robot.description import RobotDescription
from sim.pioneer.firmware import Firmware
from sim.pioneer.models import config_of
from sim.pioneer.ros2_robot import Ros2Robot
from sim.pioneer.trial import BaseTrial
from sim.world.rover import Rover

NS = 1_000_000_000
WALL_NS = 1_700_000_000 * NS
"""Time of the wall clock when the virtual clock shows 0."""


def simulated_base(
    robot: RobotDescription, rover: Rover, trial: BaseTrial, *, gyro: bool, seed: int = 0
) -> Firmware | Ros2Robot:
    """Return a robot on a rover, with or without a gyro for its driver, whose clock begins at 0."""
    if robot.arcos is not None:
        flash = replace(config_of(robot), has_gyro=int(gyro))
        return Firmware(robot, rover, config=flash, trial=trial, gyro_seed=seed)
    assert robot.topics is not None
    # No laser: without sonar_stop_m the gate does not look at it.
    topics = robot.topics.model_copy(update={"scan": None})
    known = robot.model_copy(update={"topics": topics} if gyro else {"topics": topics, "gyro": None})
    return Ros2Robot(known, rover, trial=trial, seed=seed)


def virtual_line(robot: Firmware | Ros2Robot, limits: Limits | None = None) -> "ArcosLine | Ros2Line":
    """Return the line to a robot whose clock begins at 0."""
    return ArcosLine(robot, limits) if isinstance(robot, Firmware) else Ros2Line(robot, limits)


class ArcosLine:
    """The bytes between a Pioneer's firmware and its session, as a `bridge.pioneer.base.Connection`."""

    endpoint = "virtual"

    def __init__(self, firmware: Firmware, limits: Limits | None) -> None:
        self._firmware, self._now = firmware, 0.0
        self.limits = limits or Limits()
        self.bytes_to_base = self.bytes_from_base = 0
        self.arrivals: list[object] = [Opened()]
        """What the base has not taken yet, as in `Ros2Line`."""
        most = MotionLimits(v=self.limits.v_max, omega=self.limits.omega_max)
        self.base = ArcosBase(self, Session(firmware.robot, most))

    @property
    def due_s(self) -> float:
        """When the robot next sends something by itself."""
        return self._firmware.due_s

    def advance(self, now: float) -> None:
        """Let time pass until ``now`` s."""
        self._now = now
        self._firmware.advance(now)
        self._collect()

    def _collect(self) -> None:
        if data := self._firmware.data_to_send():
            self.bytes_from_base += len(data)
            self.arrivals.append(Received(data))

    def write(self, data: bytes) -> None:
        """Bring bytes to the base."""
        self.bytes_to_base += len(data)
        self._firmware.receive(data, self._now)
        self._collect()

    def use(self) -> None:
        """Do nothing: there is only one connection."""

    def drop(self) -> None:
        """Do nothing: the connection never breaks."""

    def close(self) -> None:
        """Do nothing: the connection stays open."""

    def set_baudrate(self, baudrate: int) -> None:
        """Do nothing: the connection has no rate."""

    def reopen(self, reason: str) -> None:
        """Open a new connection."""
        self.arrivals.append(Opened())


class Ros2Line:
    """The messages between a ROS 2 robot and its base, as a `bridge.ros2.base.Connection`."""

    endpoint, zid = "virtual", "bridge"
    source: bytes | None = None

    def __init__(self, robot: Ros2Robot, limits: Limits | None) -> None:
        self._robot, self._now = robot, 0.0
        self.limits = limits or gate_limits(None, robot.description)
        self.bytes_to_base = self.bytes_from_base = 0
        self.arrivals: list[object] = []
        # Every driver may drive: a bridge on a virtual clock does not die.
        self.base = Ros2Base(self, robot.description, unsafe=True)

    @property
    def due_s(self) -> float:
        """When the robot next sends something by itself."""
        return self._robot.due_s

    def advance(self, now: float) -> None:
        """Let time pass until ``now`` s."""
        self._now = now
        self._robot.advance(now)
        for topic, payload in self._robot.messages():
            self.bytes_from_base += len(payload)
            self.arrivals.append(RobotMessage(topic, payload, now))

    def publish(self, payload: bytes) -> None:
        """Bring a command to the robot."""
        self.bytes_to_base += len(payload)
        self._robot.command(payload, self._now)

    def wait(self, seconds: float) -> None:
        """Do nothing: the owner of the virtual clock lets time pass."""

    def topic(self, name: str) -> str:
        """Return a topic; there is no namespace."""
        return name

    def close(self) -> None:
        """Do nothing: the session stays open."""
