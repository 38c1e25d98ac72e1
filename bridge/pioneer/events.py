"""Events of a session with a base."""

from dataclasses import dataclass
from typing import TypeAlias

from bridge.pioneer.odometry import BaseState
from bridge.pioneer.packets import ConfigPac
from bridge.pioneer.robots import RobotParameters


@dataclass(frozen=True)
class Connected:
    """The handshake is done; the base's names."""

    name: str
    robot_class: str
    subtype: str


@dataclass(frozen=True)
class Configured:
    """The base is ready. ``config`` is None when it never sent its CONFIGpac."""

    config: ConfigPac | None
    robot: RobotParameters


@dataclass(frozen=True)
class StateReceived:
    """A SIP arrived."""

    state: BaseState


@dataclass(frozen=True)
class GyroHeard:
    """The base's gyro: its mean rate of turn since the last, rad/s, with an offset of its own."""

    rate: float


@dataclass(frozen=True)
class Lost:
    """A ready base was lost; setpoints are zero and the motors must be requested again."""

    reason: str


@dataclass(frozen=True)
class Recovered:
    """A silent base sends packets again, in the same session."""


@dataclass(frozen=True)
class Failed:
    """Connecting failed; only another ``connect`` continues."""

    reason: str


@dataclass(frozen=True)
class BaudChanged:
    """The serial line is to run at this rate before anything more is sent."""

    baudrate: int


Event: TypeAlias = (
    Connected | Configured | StateReceived | GyroHeard | Lost | Recovered | Failed | BaudChanged
)
