"""Driver and bridge agree by this protocol on the lease, which is the permission to drive.

One driver at a time holds the lease. The driver requests it on ``rover/motors`` with its clock's time.
The bridge answers with its own time, the number of the lease and a fresh key of 32 random bytes. From
then on the driver signs each command, renewal and release with that key, and adds a sequence number and
the time of sending. The bridge thus distinguishes the holder of the lease from all others, and a stale
command from a fresh one, although the two clocks are not synchronised.

The attachment of a signed message is a tag of 40 bytes, little-endian:

| bytes | content |
|---|---|
| 0-7 | number of the lease |
| 8-15 | sequence number, which rises with each message |
| 16-23 | the driver's monotonic clock in ns, signed |
| 24-39 | digest |

The digest is BLAKE2b of 16 bytes with the lease's key and the personalisation `rover-ncp lease`. It
covers, in this order:

1. the protocol's version (1 byte, 2);
2. the kind of message (1 byte: 1 command, 2 request for the motors);
3. the length of the key expression (2 bytes);
4. lease number, sequence number and stamp, as in the tag;
5. the key expression with its namespace (UTF-8);
6. the payload.

Rules:

- The bridge verifies the digest before it parses the payload. A message with a wrong digest changes only
  a counter.
- While a lease is held, the bridge refuses every other request for the motors (`another-driver`).
- A signed request renews or releases the lease. Each sequence number counts once.
- The answer to a renewal does not repeat the key. A driver that lost the first answer waits until the
  lease expires (1 s).
- A driver that gets two answers to its request does not start (exit 3): a peer beside the bridge may have
  relayed the request and know the key.
- No other message, log, JSON output, status or recording holds the key. `rover/gate` shows the number of
  the lease and the name of its driver.
"""

import hmac
import struct
from enum import IntEnum, StrEnum
from hashlib import blake2b
from typing import Annotated, NamedTuple, Self

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from rover_ncp.core.config import ModelT, StrictModel
from rover_ncp.core.errors import FormatError

PROTOCOL = 2
"""Version of this protocol, in each digest."""
KEY_BYTES = 32
"""Length of a lease's key."""

_TAG = struct.Struct("<QQq16s")
TAG_BYTES = _TAG.size
_SIGNED = struct.Struct("<BBHQQq")
_PERSON = b"rover-ncp lease"
_JSON_MAX_BYTES = 4096

LeaseKey = Annotated[str, Field(pattern=rf"^([0-9a-f]{{{2 * KEY_BYTES}}})?$")]
ShortText = Annotated[str, Field(max_length=200)]
Nanoseconds = Annotated[int, Field(ge=-(2**63), lt=2**63)]


class Signed(IntEnum):
    """The kinds of message that a driver signs."""

    COMMAND = 1
    MOTORS = 2
    """A renewal or a release, by the signed payload."""


class CommandTag(NamedTuple):
    """The attachment of each command, renewal and release: 40 bytes, little-endian.

    ``lease`` is the lease's number, ``sequence`` rises with each message under it, and ``stamp_ns`` is the
    driver's monotonic clock at the time of sending. ``digest`` is BLAKE2b with the lease's key over the
    protocol's version, the kind of message, the namespaced key expression, these numbers and the payload.
    """

    lease: int
    sequence: int
    stamp_ns: int
    digest: bytes = bytes(16)

    def sign(self, secret: bytes, kind: Signed, key_expr: str, payload: bytes) -> Self:
        """Return the tag with its digest. Raises FormatError for numbers that do not fit."""
        return self._replace(digest=self._digest(secret, kind, key_expr, payload))

    def verify(self, secret: bytes, kind: Signed, key_expr: str, payload: bytes) -> bool:
        """Return whether the digest was made with this key for this very message."""
        return hmac.compare_digest(self.digest, self._digest(secret, kind, key_expr, payload))

    def _digest(self, secret: bytes, kind: Signed, key_expr: str, payload: bytes) -> bytes:
        name = key_expr.encode()
        try:
            head = _SIGNED.pack(PROTOCOL, kind, len(name), self.lease, self.sequence, self.stamp_ns)
        except struct.error as error:
            raise FormatError(f"command tag: {error}") from error
        # The lengths of all parts but the last are known, so no two messages have the same bytes.
        return blake2b(head + name + payload, digest_size=16, key=secret, person=_PERSON).digest()

    def pack(self) -> bytes:
        """Return the 40 bytes. Raises FormatError for values that do not fit."""
        if len(self.digest) != 16:
            raise FormatError(f"a command tag's digest has 16 bytes, not {len(self.digest)}")
        try:
            return _TAG.pack(*self)
        except struct.error as error:
            raise FormatError(f"command tag: {error}") from error

    @classmethod
    def unpack(cls, data: bytes) -> Self:
        """Read an attachment. Raises FormatError unless it has 40 bytes."""
        if len(data) != _TAG.size:
            raise FormatError(f"a command tag has {_TAG.size} bytes, not {len(data)}")
        return cls(*_TAG.unpack(data))


class MotorsRequest(StrictModel):
    """Request or renewal of the lease, or its release; ``sent_ns`` is the driver's monotonic clock.

    A renewal and a release carry a `CommandTag`; a first request does not.
    """

    enable: bool
    name: ShortText = ""
    sent_ns: Nanoseconds = 0


class MotorsReply(StrictModel):
    """Grant, renewal, refusal or end of a lease.

    ``reason`` is the gate's name of the reason for a refusal, ``detail`` its words. ``key`` is the key of a
    new lease in hexadecimal. It is empty in the answer to a renewal: a peer that got hold of a signed renewal
    and delivered it first would learn the key from that answer.
    """

    granted: bool = False
    reason: str = ""
    detail: str = ""
    lease: int = Field(default=0, ge=0, lt=2**64)
    key: LeaseKey = Field(default="", repr=False)


class StopRequest(StrictModel):
    """Stop until released, or release. ``reason`` names sender and cause; it follows "stopped by"."""

    release: bool = False
    reason: ShortText = ""


class StopReply(StrictModel):
    """Whether the stop is latched now, and why."""

    stopped: bool
    reason: str = ""


class BaseRequest(StrictModel):
    """Query for the base's model, its timeout and what it reports."""


class TimeoutState(StrEnum):
    """How the base's timeout is known, after which it halts without commands."""

    PUBLISHED = "published"
    """The base's configuration gives it."""
    MEASURED = "measured"
    """It was measured on this very robot, and its description has it."""
    UNKNOWN = "unknown"
    """Nothing confirms it."""


class BaseReply(StrictModel):
    """The base's model, the lowest voltage of its battery, and its timeout in s; None = not known.

    A timeout of the state ``unknown`` is the factory setting. ``unheard`` are inputs of the description that
    have sent nothing, each with what was found instead. ``clock`` is how the clock that stamps odometry runs
    at another rate than the bridge's; "" if it does not, None = not known yet. ``problem`` is why the base is
    lost, or why it is not known whether there is a hazard; "" if neither. ``version`` and ``zenoh`` are the
    bridge's, ``wall_ns`` is its wall clock when the query arrived. ``room_m`` is the free way ahead and
    behind by sonar or laser; None = not known or nothing there.
    """

    model: str
    battery_min_v: float | None = None
    state: TimeoutState
    timeout_s: float | None = None
    unheard: tuple[str, ...] = ()
    clock: str | None = ""
    problem: str = ""
    version: str = ""
    zenoh: str = ""
    wall_ns: Nanoseconds = 0
    room_m: tuple[float | None, float | None] = (None, None)


REASONS = {
    "stopped": "a stop was requested, and is not released",
    "no-base": "the base is not connected",
    "stop-button": "the STOP button is pressed",
    "hazard-unknown": "a topic that reports hazards cannot be relied on",
    "bumper": "a bumper is pressed",
    "stall": "a motor is stalled",
    "low-battery": "the battery is low",
    "motors-off": "the base reports its motors off",
    "odometry": "the base reports no pose, or its odometry is stale",
    "odometry-frozen": "the base reports the same pose while it reports a speed",
    "fence-lost": "odometry restarted or jumped, so the place of the fence is not known: put the rover where "
    "odom is to begin, and restart the bridge",
    "silence": "no fresh command arrives",
    "lease-lapsed": "no command arrived for longer than a lease lasts",
    "no-lease": "no driver holds the lease",
    "another-driver": "another driver holds the lease",
    "foreign": "not signed by the driver that holds the lease",
    "repeated": "a message with this sequence number, or a later one, has arrived already",
    "stale": "commands arrived too late",
    "unreadable": "no velocity command",
    "not-finite": "not a finite number",
    "geofence": "the rover would leave the geofence",
    "sonar": "an obstacle is near in the commanded direction, or the sonars there report nothing",
}
"""Text of each reason of the gate."""
UNNAMED = "a client that gave no name"
CONTACTS = frozenset({"bumper", "stall"})
"""The reasons that report that the rover touched something."""


def in_words(reason: str, detail: str = "") -> str:
    """Return a gate's reason with its words, or with those of the gate."""
    words = detail or REASONS.get(reason, "")
    return f"{reason}: {words}" if words else reason


Edge = Annotated[float, Field(ge=-1e5, le=1e5)]


class Fence(StrictModel):
    """A rectangle in odom, in metres; the base's centre stays inside."""

    x_min: Edge
    """Its rear edge."""
    x_max: Edge
    """Its front edge."""
    y_min: Edge
    """Its right edge."""
    y_max: Edge
    """Its left edge."""

    @model_validator(mode="after")
    def _has_an_inside(self) -> Self:
        if self.x_min >= self.x_max or self.y_min >= self.y_max:
            raise ValueError("a fence needs x_min < x_max and y_min < y_max")
        return self

    def outside(self, x: float, y: float) -> float:
        """Return the distance of a point beyond the sides, in metres; 0 inside."""
        return max(self.x_min - x, x - self.x_max, self.y_min - y, y - self.y_max, 0.0)


class GateStatus(StrictModel):
    """The gate's state, on ``rover/gate`` at each change and ten times a second.

    ``lease`` is the number of the lease that is held (0 = none), ``driver_name`` its holder, ``sequence`` the
    newest number that the gate accepted under it (-1 = none). ``held`` names what holds the rover at zero now
    ("" = nothing, a command is in force), and ``held_detail`` has the words for it. ``ended`` names what took
    the last lease away ("" = it is held, or was given back), and ``ended_detail`` has the words for it.
    Counters are since the bridge's start, by name of the gate's reason: commands ``dropped``, commands
    ``limited``, and ``stops``, how often a command in force was cut off.
    """

    lease: int = 0
    driver_name: str = ""
    sequence: int = -1
    held: str = ""
    held_detail: str = ""
    ended: str = ""
    ended_detail: str = ""
    stop_reason: str = ""
    """The text of a latched stop."""
    accepted: int = 0
    dropped: dict[str, int] = Field(default_factory=dict)
    limited: dict[str, int] = Field(default_factory=dict)
    stops: dict[str, int] = Field(default_factory=dict)
    fence: Fence | None = None
    """The fence of the gate; None without one."""

    def contact_since(self, before: "GateStatus") -> str:
        """Return the contact that is reported, or cut off a command since ``before``; "" if none."""
        found = [
            self.held,
            self.ended,
            *(name for name in self.stops if self.stops[name] > before.stops.get(name, 0)),
        ]
        return next((REASONS[name] for name in found if name in CONTACTS), "")


class DriverStatus(StrictModel):
    """Status of the driving process on ``rover/status``.

    ``drive`` is the id of the drive: statuses of another drive have another one.
    ``error_95_m`` is the position error that 95 % of estimates like the present one do not exceed.
    ``probability``, at the end, is that of the rover being within the tolerances, by the estimate.
    """

    model_config = ConfigDict(extra="ignore")  # recordings of earlier versions have more fields

    state: str
    drive: str = ""
    reason: str = ""
    policy: str = ""
    course: str = ""
    tick: int = 0
    t_s: float = 0.0
    overruns: int = 0
    error_95_m: float | None = None
    probability: float | None = None


def parse_json(model: type[ModelT], data: bytes | str) -> ModelT:
    """Read a peer's JSON. Raises FormatError naming the first wrong field."""
    if len(data) > _JSON_MAX_BYTES:
        raise FormatError(f"{model.__name__}: {len(data)} bytes, expected at most {_JSON_MAX_BYTES}")
    try:
        return model.model_validate_json(data)
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False, include_context=False)[0]
        where = ".".join(str(part) for part in first["loc"]) or "JSON"
        raise FormatError(f"{model.__name__}: {where}: {first['msg']}") from error


def dump_json(model: BaseModel) -> bytes:
    """Return a model as JSON bytes."""
    return model.model_dump_json().encode()
