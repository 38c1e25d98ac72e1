"""Interface of a base, independent of its protocol: reports and events out, setpoints in."""

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import NamedTuple, Protocol, TypeAlias

from rover_ncp.core.errors import NoRobot, RoverNcpError
from rover_ncp.core.geometry import Velocity
from rover_ncp.robot.description import RobotDescription
from rover_ncp.wire.protocol import TimeoutState


class Setpoint(NamedTuple):
    """The gate's output for the base."""

    velocity: Velocity
    motors: bool
    emergency: bool
    """Whether to brake harder than the base's own deceleration limit."""
    lease: int = 0
    """Number of the lease, 0 without one. With each new one, the motors must be requested again."""


@dataclass(frozen=True)
class BaseReport:
    """One report of the base, in SI units. Its pose is in odom, whose origin is the pose at connecting."""

    x: float = 0.0
    y: float = 0.0
    theta: float = 0.0
    """Heading in rad, counter-clockwise, not wrapped."""
    v: float = 0.0
    omega: float = 0.0
    age_s: float = 0.0
    """Age of the measurement at its arrival, as far as the base reports it."""
    battery_v: float = 0.0
    """0 = not reported."""
    charging: bool | None = None
    """None = not known."""
    battery_age_s: float = 0.0
    """Age of the battery's state: some robots report it seldom."""
    motors_on: bool = True
    stop_pressed: bool = False
    hazard_unknown: str = ""
    """Why it is not known whether a stop is pressed or a hazard is there; "" = it is known."""
    stalled: tuple[bool, bool] = (False, False)
    """Left and right motor."""
    bumpers: tuple[int, int] = (0, 0)
    """Bits of the front and rear segments, bit 0 first; 0 when the base is not known to have any.

    Contact on an unknown side sets both: with one of them the rover may be driven away from it.
    """
    sonar: Mapping[int, float] = field(default_factory=dict)
    """Ranges in m of the sonars read since the last report, by number."""
    clear_ahead_m: float = math.nan
    clear_behind_m: float = math.nan
    """Shortest recent sonar ranges before and behind the base; NaN = not known."""
    room_unknown: str = ""
    """Why one of them is not known, as far as the base knows; "" = both are, or there are no such sensors."""
    flags: int = 0
    faults: int = 0
    """Status and fault bits as the base sent them."""


@dataclass(frozen=True)
class Ready:
    """The base is connected: its name, and its description."""

    hardware: str
    robot: RobotDescription


@dataclass(frozen=True)
class TurnRate:
    """Mean turn rate by the base's gyro since its previous reading, rad/s, with an unknown constant offset.

    Its time ends ``age_s`` before it arrives.
    """

    rate: float
    age_s: float = 0.0


@dataclass(frozen=True)
class PassedOn:
    """A message of the robot that the bridge publishes as it is, on a key of the table."""

    key: str
    data: bytes


@dataclass(frozen=True)
class Lost:
    """A ready base was lost: it gets no speed but zero, and its motors must be requested again."""

    reason: str


@dataclass(frozen=True)
class Recovered:
    """A lost base sends reports again, on the same connection."""


@dataclass(frozen=True)
class Failed:
    """The base cannot be reached. One that was ready keeps trying; otherwise the bridge ends."""

    reason: str


@dataclass(frozen=True)
class Notice:
    """A text for the log."""

    text: str


BaseEvent: TypeAlias = Ready | BaseReport | TurnRate | PassedOn | Lost | Recovered | Failed | Notice


class BaseTimeout(NamedTuple):
    """Time in s after which the base halts without commands; None = not known.

    With the state ``UNKNOWN`` it is the factory setting, which the base does not confirm. ``refusal`` is why
    the bridge grants no lease; "" = it does.
    """

    state: TimeoutState
    timeout_s: float | None
    refusal: str = ""


class LinkHealth(NamedTuple):
    """Quality of the line to the base, for diagnostics."""

    damaged: bool
    """Whether messages were damaged or could not be read lately."""
    counters: Mapping[str, int]
    unheard: tuple[str, ...] = ()
    """Inputs of the description that have sent nothing, each with what was found instead."""
    clock: str | None = ""
    """How the clock of odometry runs at another rate; "" if it does not, None = not known yet."""


class Base(Protocol):
    """A base. Its own thread puts what arrives from it into the bridge's inbox; all else runs in the loop.

    ``now`` is the bridge's monotonic clock in seconds. A base whose odometry restarted sends `Ready` again.
    If the bridge hangs, the robot must halt by itself: ``base_timeout`` says after which time, and the gate
    believes it. An exception ends the bridge: it drives zero with the motors off, calls ``close``, and exits
    with 3, or with 4 if there is a fence. At every other end it does the same.
    """

    def receive(self, arrival: object, now: float) -> Sequence[BaseEvent]:
        """Process what the base's thread put into the inbox, and return the events."""

    def drive(self, setpoint: Setpoint, now: float) -> Sequence[BaseEvent]:
        """Pass on a setpoint, let time pass, and return the events. The only source of keep-alives."""

    def health(self) -> LinkHealth:
        """Return the quality of the line."""

    @property
    def base_timeout(self) -> BaseTimeout:
        """Time after which the base halts when this process dies."""

    def close(self, now: float) -> None:
        """Stop the base, switch its motors off and end the connection."""


@contextmanager
def base_failures() -> Iterator[None]:
    """Raise NoRobot in place of any exception of a base, whose methods are called in this context."""
    try:
        yield
    except Exception as error:
        plain = isinstance(error, OSError | RoverNcpError)
        raise NoRobot(f"the base failed: {error if plain else repr(error)}") from error
