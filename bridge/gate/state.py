"""What the gate takes in, remembers and gives out: its vocabulary, without any rule."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import TypeAlias

from rover_ncp.core.geometry import Velocity
from rover_ncp.core.protocol import CommandTag

ZERO = Velocity(0.0, 0.0)


class Reason(StrEnum):
    """Why the rover is held, a command did not count, or was changed."""

    STOPPED = "stopped"
    """Somebody asked ``rover/stop``, and nobody has released it."""
    NO_BASE = "no-base"
    STOP_BUTTON = "stop-button"
    BUMPER = "bumper"
    STALL = "stall"
    LOW_BATTERY = "low-battery"
    MOTORS_OFF = "motors-off"
    ODOMETRY = "odometry"
    """The base was not heard of late, or says where it is in numbers that are none."""
    FROZEN = "odometry-frozen"
    """Its pose stands still while it says that it drives."""
    NO_LEASE = "no-lease"
    SILENCE = "silence"
    LEASE_LAPSED = "lease-lapsed"
    ANOTHER_DRIVER = "another-driver"
    FOREIGN = "foreign"
    """Not signed by the holder of the lease."""
    REPEATED = "repeated"
    STALE = "stale"
    UNREADABLE = "unreadable"
    NOT_FINITE = "not-finite"
    SPEED = "speed"
    TURN = "turn"
    GEOFENCE = "geofence"
    SONAR = "sonar"
    """Something is near where the rover is told to go, or the sonars there have fallen silent."""


EMERGENCIES = frozenset({Reason.STOPPED, Reason.STOP_BUTTON, Reason.BUMPER, Reason.STALL})
"""Here the base is told to brake harder than it is used to."""


@dataclass(frozen=True)
class Tick:
    """Time went on."""


@dataclass(frozen=True)
class Heard:
    """The base reported: SI units, pose in odom.

    The clearances are the shortest ranges that the sonars heard of late, NaN when they cannot tell.
    """

    x: float = 0.0
    y: float = 0.0
    theta: float = 0.0
    v: float = 0.0
    omega: float = 0.0
    battery_v: float = 0.0
    """0 = not reported."""
    motors_on: bool = True
    stop_pressed: bool = False
    stalled: bool = False
    bumped: bool = False
    clear_ahead_m: float = math.nan
    clear_behind_m: float = math.nan


@dataclass(frozen=True)
class BaseLost:
    """The link to the base is gone, or it was set up anew."""


@dataclass(frozen=True)
class Command:
    """A command for a velocity; None = the bytes were no velocity, or were not read.

    ``signed`` is whether the tag's digest is valid under the key of the lease that is held. ``age_s`` is only
    for a command without a tag: how long ago it says it was sent, None if it does not say.
    """

    velocity: Velocity | None
    tag: CommandTag | None = None
    age_s: float | None = None
    signed: bool = False


@dataclass(frozen=True)
class Enable:
    """A driver asks for the motors; ``sent_ns`` is its own monotonic clock.

    ``secret`` is the key of the lease if it is a new one, None for plain ROS commands. ``sequence`` is the
    request's number if it is a renewal, signed with the key of the lease that is held; else None.
    """

    name: str = ""
    sent_ns: int = 0
    secret: bytes | None = field(default=None, repr=False)
    sequence: int | None = None


@dataclass(frozen=True)
class Release:
    """The holder of the lease gives the motors back, in a signed request with this number."""

    sequence: int


@dataclass(frozen=True)
class Stop:
    """Somebody asks for a stop until it is released."""

    reason: str = ""


@dataclass(frozen=True)
class Unlatch:
    """Somebody releases the stop."""


Event: TypeAlias = Tick | Heard | BaseLost | Command | Enable | Release | Stop | Unlatch


@dataclass(frozen=True)
class Lease:
    """Who may drive, and until when unless a command comes."""

    number: int
    """From 1, in the order of the grants."""
    secret: bytes | None = field(repr=False)
    """The key that signs; None where plain ROS commands drive, which are not signed."""
    name: str
    sent_ns: int
    """The driver's clock when it asked: a command sent before that is not of this lease."""
    granted_s: float
    expires_s: float
    last_sequence: int = -1


@dataclass(frozen=True)
class State:
    """All that the gate remembers."""

    now: float = -math.inf
    lease: Lease | None = None
    leases: int = 0
    """How many were granted."""
    ended: Reason | None = None
    """What ended the last lease; None if it was given back."""
    latched: str | None = None
    """The words of a stop that was asked for."""
    base: Heard | None = None
    base_s: float = -math.inf
    low_since_s: float | None = None
    same: int = 0
    """How often the base reported the same pose again."""
    unseen_m: float = 0.0
    unseen_rad: float = 0.0
    """How far the base must have come by its own speeds since the pose it reports last changed."""
    target: Velocity | None = None
    """The command in force, until ``target_until_s``."""
    target_until_s: float = -math.inf
    idle: Reason = Reason.SILENCE
    """Why there is no command in force, if there is none."""
    held: Reason | None = Reason.NO_BASE
    out: Velocity = ZERO
    minima: tuple[tuple[int, float], ...] = ()
    """Second of arrival, and the smallest (arrival − stamp) in it."""
    motors: bool = False
    motors_until_s: float = -math.inf
    untagged_until_s: float = -math.inf
    """Untagged commands do not drive before this: after a hazard, let go of the stick first."""
    accepted: int = 0
    dropped: Mapping[Reason, int] = field(default_factory=dict)
    """Commands that did not count."""
    stops: Mapping[Reason, int] = field(default_factory=dict)
    """How often a command in force was cut off."""
    limited: Mapping[Reason, int] = field(default_factory=dict)
    """Commands that were cut down."""


@dataclass(frozen=True)
class Verdict:
    """What to do now."""

    velocity: Velocity
    motors: bool
    held: Reason | None
    """Why the rover is held at zero; None while a command is in force."""
    refusal: Reason | None = None
    """Why an `Enable` was not granted."""
    dropped: Reason | None = None
    """Why a `Command` did not count."""
    lease: Lease | None = None
    """The lease that is held now."""

    @property
    def emergency(self) -> bool:
        """Whether to brake harder than the base's own limit."""
        return self.held in EMERGENCIES
