"""Events, state and verdict of the gate; the rules are in `gate.py`."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import NamedTuple, TypeAlias

from bridge.base import BaseReport
from rover_ncp.core.errors import FormatError
from rover_ncp.core.geometry import STANDSTILL, Velocity
from rover_ncp.wire.protocol import REASONS, UNNAMED, CommandTag, Signed

DETAIL_LENGTH = 200


class Reason(StrEnum):
    """Reason for a hold, a dropped command or a changed command."""

    STOPPED = "stopped"
    """A stop was requested on ``rover/stop`` and is not yet released."""
    NO_BASE = "no-base"
    STOP_BUTTON = "stop-button"
    HAZARD_UNKNOWN = "hazard-unknown"
    """A topic that reports a stop button or hazards is silent, or its messages cannot be read."""
    BUMPER = "bumper"
    STALL = "stall"
    LOW_BATTERY = "low-battery"
    MOTORS_OFF = "motors-off"
    ODOMETRY = "odometry"
    """Odometry is stale, or its pose is not finite."""
    FROZEN = "odometry-frozen"
    """Frozen odometry: the base reports the same pose while it reports a speed."""
    FENCE_LOST = "fence-lost"
    """Odometry restarted or jumped: the place of the fence is not known until the bridge is restarted."""
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
    """An obstacle is near in the commanded direction, or the sonars there have sent nothing for too long."""


EMERGENCIES = frozenset({Reason.STOPPED, Reason.STOP_BUTTON, Reason.BUMPER, Reason.STALL})
"""For these reasons the base brakes harder than its own deceleration limit."""
AT_THE_ROBOT = frozenset(
    {Reason.STOP_BUTTON, Reason.BUMPER, Reason.STALL, Reason.LOW_BATTERY, Reason.FROZEN, Reason.FENCE_LOST}
)
"""Hazards that the base reports of itself; a person must look at it before it drives again."""


@dataclass(frozen=True)
class Tick:
    """Time went on."""


@dataclass(frozen=True)
class BaseLost:
    """The link to the base is gone, or it was set up anew; then odometry may have ``restarted``."""

    reason: str = ""
    restarted: bool = False


@dataclass(frozen=True)
class VelocityCommand:
    """A velocity command; None = the bytes were not a velocity, or were not read.

    ``signed`` is whether the tag's digest is valid under the key of the current lease.
    """

    velocity: Velocity | None
    tag: CommandTag
    signed: bool = False


@dataclass(frozen=True)
class Enable:
    """A driver's request for the lease; ``sent_ns`` is its own monotonic clock.

    ``secret`` is the key of the lease if it is a new one. ``sequence`` is the request's number if it is a
    renewal, signed with the key of the current lease; else None.
    """

    name: str
    sent_ns: int
    secret: bytes = field(repr=False)
    sequence: int | None = None


@dataclass(frozen=True)
class Release:
    """The holder of the lease releases it, in a signed request with this number."""

    sequence: int


@dataclass(frozen=True)
class Stop:
    """A request for a stop that holds until it is released."""

    reason: str = ""


@dataclass(frozen=True)
class ReleaseStop:
    """A request to release the stop."""


GateEvent: TypeAlias = Tick | BaseReport | BaseLost | VelocityCommand | Enable | Release | Stop | ReleaseStop


class Contact(NamedTuple):
    """What touches the base: the bits of the pressed front and rear bumpers, and whether a motor stalls."""

    front: int = 0
    rear: int = 0
    stalled: bool = False


NO_CONTACT = Contact()


@dataclass(frozen=True)
class Lease:
    """A driver's lease, and when it expires without a command."""

    number: int
    """From 1, in the order of the grants."""
    secret: bytes = field(repr=False)
    """The signing key."""
    name: str
    granted_s: float
    """When it was granted; renewals do not change that."""
    expires_s: float
    last_sequence: int
    contact: Contact
    """The contact in which it was granted, as far as it lasted until the last command that led away."""

    def signed(self, tag: CommandTag, kind: Signed, key_expr: str, payload: bytes) -> bool:
        """Return whether a message's digest is valid under the key of this lease."""
        return tag.lease == self.number and tag.verify(self.secret, kind, key_expr, payload)


def read_tag(attachment: bytes | None) -> CommandTag:
    """Return the tag of a message; without a valid attachment one that is valid under no lease."""
    try:
        return CommandTag.unpack(attachment or b"")
    except FormatError:
        return CommandTag(0, 0, 0)  # no lease has the number 0


class GateState(NamedTuple):
    """The gate's whole state. Each event replaces it: a named tuple in 1 µs, a frozen dataclass in 19 µs."""

    now: float = -math.inf
    lease: Lease | None = None
    leases: int = 0
    """Number of leases granted so far."""
    lease_over: Reason | None = None
    """Reason for the end of the last lease; None if its driver released it."""
    lease_over_detail: str = ""
    """Text of ``lease_over``, from the moment when the lease ended."""
    stop_reason: str | None = None
    """The text of the stop request; None without one."""
    base: BaseReport | None = None
    lost: str = ""
    """Reason for the last loss of the base."""
    base_s: float = -math.inf
    low_since_s: float | None = None
    pose_s: float = -math.inf
    """When the base first reported its present pose."""
    halted_s: float = -math.inf
    """When the output was last zero while the base reported motion."""
    repeats: int = 0
    """Number of repeated reports of the same pose."""
    frozen_m: float = 0.0
    frozen_rad: float = 0.0
    """Distance by the base's reported speeds since its reported pose last changed.

    If these are means, those of a rover that halts count when they no longer include motion before that.
    """
    stalled_v: float = 0.0
    """Direction of travel when a motor began to stall: 1 forward, −1 backward, 0 unknown."""
    odometry_restarted: bool = False
    """Whether the origin of odom is another place than at the first report."""
    target: Velocity | None = None
    """The command in force within the speed limits, until ``target_until_s``."""
    target_until_s: float = -math.inf
    no_command: Reason = Reason.SILENCE
    """Hold reason while there is no command in force."""
    held: Reason | None = Reason.NO_BASE
    out: Velocity = STANDSTILL
    minima: tuple[tuple[int, float], ...] = ()
    """Second of arrival, and the smallest (arrival − stamp) in it."""
    motors: bool = False
    motors_until_s: float = -math.inf
    accepted: int = 0
    dropped: Mapping[Reason, int] = {}
    """Commands that the gate dropped, by reason."""
    stops: Mapping[Reason, int] = {}
    """Number of times a command in force was cut off, by reason."""
    limited: Mapping[Reason, int] = {}
    """Commands that the gate limited, by reason."""


def describe(reason: Reason, state: GateState) -> str:
    """Return the words for a refusal, or for the end of a lease; who stopped the rover, after a request."""
    if reason is Reason.STOPPED and state.stop_reason is not None:
        return state.stop_reason or UNNAMED
    if reason is Reason.NO_BASE and state.lost:
        return f"{REASONS[reason]}: {state.lost}"[:DETAIL_LENGTH]
    base = state.base or BaseReport()
    unknown = {Reason.HAZARD_UNKNOWN: base.hazard_unknown, Reason.SONAR: base.room_unknown}
    if detail := unknown.get(reason):
        return f"{REASONS[reason]}: {detail}"[:DETAIL_LENGTH]
    if reason is Reason.ANOTHER_DRIVER and state.lease is not None:
        return f"{state.lease.name or 'a driver without a name'} holds the lease"
    return REASONS.get(reason, "")


@dataclass(frozen=True)
class Verdict:
    """The gate's decision after one event."""

    velocity: Velocity
    motors: bool
    held: Reason | None
    """Hold reason; None while a command is in force."""
    refusal: Reason | None = None
    """Reason for refusing an `Enable`."""
    dropped: Reason | None = None
    """Reason for dropping a `VelocityCommand`."""
    lease: Lease | None = None
    """The current lease."""

    @property
    def emergency(self) -> bool:
        """Whether to brake harder than the base's own limit."""
        return self.held in EMERGENCIES
