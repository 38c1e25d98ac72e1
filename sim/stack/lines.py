"""Simulated robots, and the connections between them and the bridge's base, on a virtual clock.

A connection carries the bytes or messages of the real one. Time is that of the last ``advance``.
"""

from abc import ABC, abstractmethod
from dataclasses import replace

from bridge.base import Base
from bridge.bases import gate_limits
from bridge.gate.limits import Limits
from bridge.inbox import RobotMessage
from bridge.pioneer.base import ArcosBase
from bridge.pioneer.connection import BaseConnection, Opened, Received
from bridge.pioneer.session import Session
from bridge.pioneer.setpoints import MotionLimits
from bridge.ros2.base import Ros2Base
from bridge.ros2.connection import RosConnection
from rover_ncp.core.clock_offset import NS_PER_S
from rover_ncp.robot.description import RobotDescription
from sim.base.firmware import Firmware
from sim.base.models import config_of
from sim.base.ros2_robot import Ros2Robot
from sim.base.simulated_base import SimulatedBase
from sim.base.trial import BaseTrial
from sim.world.rover import Rover

WALL_NS = 1_700_000_000 * NS_PER_S
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


class VirtualConnection(ABC):
    """Connection of one robot and its base."""

    endpoint = "virtual"
    base: Base

    def __init__(self, robot: SimulatedBase, limits: Limits) -> None:
        self._robot, self.limits, self._now = robot, limits, 0.0
        self.arrivals: list[object] = []
        """What the base has not taken yet."""

    @property
    def due_s(self) -> float:
        """When the robot next sends something by itself."""
        return self._robot.due_s

    def advance(self, now: float) -> None:
        """Let time pass until ``now`` s."""
        self._now = now
        self._robot.advance(now)
        self._collect()

    def close(self) -> None:  # noqa: B027
        """Do nothing: the connection stays open."""

    @abstractmethod
    def _collect(self) -> None:
        """Bring what the robot has sent to the base."""


class ArcosConnection(VirtualConnection, BaseConnection):
    """The bytes between a Pioneer's firmware and its session."""

    def __init__(self, firmware: Firmware, limits: Limits | None) -> None:
        super().__init__(firmware, limits or Limits())
        self._firmware = firmware
        self.reopen("")
        most = MotionLimits(v=self.limits.v_max, omega=self.limits.omega_max)
        self.base: Base = ArcosBase(self, Session(firmware.robot, most))

    def _collect(self) -> None:
        if data := self._firmware.data_to_send():
            self.arrivals.append(Received(data))

    def write(self, data: bytes) -> None:
        """Bring bytes to the base."""
        self._firmware.receive(data, self._now)
        self._collect()

    def use(self) -> None:
        """Do nothing: there is only one connection."""

    def drop(self) -> None:
        """Do nothing: the connection never breaks."""

    def set_baudrate(self, baudrate: int) -> None:
        """Do nothing: the connection has no rate."""

    def reopen(self, reason: str) -> None:
        """Open a new connection."""
        self.arrivals.append(Opened())


class Ros2Connection(VirtualConnection, RosConnection):
    """The messages between a ROS 2 robot and its base."""

    zid = "bridge"
    source: bytes | None = None

    def __init__(self, robot: Ros2Robot, limits: Limits | None) -> None:
        super().__init__(robot, limits or gate_limits(None, robot.robot))
        self._ros2_robot = robot
        # Every driver may drive: a bridge on a virtual clock does not die.
        self.base: Base = Ros2Base(self, robot.robot, unsafe=True)

    def _collect(self) -> None:
        for topic, payload in self._ros2_robot.messages():
            self.arrivals.append(RobotMessage(topic, payload, self._now))

    def publish(self, payload: bytes) -> None:
        """Bring a command to the robot."""
        self._ros2_robot.command(payload, self._now)

    def wait(self, seconds: float) -> None:
        """Do nothing: the owner of the virtual clock lets time pass."""

    def topic(self, name: str) -> str:
        """Return a topic; there is no namespace."""
        return name
