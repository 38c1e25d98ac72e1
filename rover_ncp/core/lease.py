"""What driver and bridge tell each other about the right to drive: command tags and JSON of the queries.

The driver asks ``rover/motors`` with its clock's time; the bridge answers with its own. From then on each
command carries the driver's id, a sequence number and the driver's time of sending, and the bridge can tell
an old command from a fresh one although the two clocks agree in nothing.
"""

import struct
from typing import Annotated, NamedTuple, Self, TypeVar

from pydantic import BaseModel, Field, ValidationError

from rover_ncp.core.config import StrictModel
from rover_ncp.core.errors import FormatError

__all__ = [
    "CommandTag",
    "DriverStatus",
    "GateStatus",
    "MotorsReply",
    "MotorsRequest",
    "ResetReply",
    "ResetRequest",
    "StopReply",
    "StopRequest",
    "dump_json",
    "parse_json",
]

_TAG = struct.Struct("<16sQq")
_JSON_MAX_BYTES = 4096

DriverId = Annotated[str, Field(pattern=r"^[0-9a-f]{32}$")]
ShortText = Annotated[str, Field(max_length=200)]
Nanoseconds = Annotated[int, Field(ge=-(2**63), lt=2**63)]


class CommandTag(NamedTuple):
    """What rides in the attachment of each ``cmd_vel``: 32 bytes, little-endian.

    ``driver`` is 16 random bytes of one driving process; ``sequence`` rises with each command; ``stamp_ns``
    is the driver's monotonic clock when it was sent.
    """

    driver: bytes
    sequence: int
    stamp_ns: int

    def pack(self) -> bytes:
        """Return the 32 bytes. Raises FormatError for values that do not fit."""
        if len(self.driver) != 16:
            raise FormatError(f"a driver's id has 16 bytes, not {len(self.driver)}")
        try:
            return _TAG.pack(*self)
        except struct.error as error:
            raise FormatError(f"command tag: {error}") from error

    @classmethod
    def unpack(cls, data: bytes) -> Self:
        """Read an attachment. Raises FormatError unless it has 32 bytes."""
        if len(data) != _TAG.size:
            raise FormatError(f"a command tag has {_TAG.size} bytes, not {len(data)}")
        return cls(*_TAG.unpack(data))


class MotorsRequest(StrictModel):
    """Ask for the motors and the lease, or give them back; ``sent_ns`` is the driver's monotonic clock."""

    enable: bool
    driver: DriverId
    name: ShortText = ""
    sent_ns: Nanoseconds = 0


class MotorsReply(StrictModel):
    """``reason`` is the gate's name for why not, ``detail`` its words; ``received_ns`` the bridge's clock.

    ``limits`` are the gate's: v in m/s, omega in rad/s, accel in m/s², alpha in rad/s².
    """

    granted: bool
    reason: str = ""
    detail: str = ""
    lease_s: float = 0.0
    received_ns: Nanoseconds = 0
    limits: dict[str, float] = Field(default_factory=dict)


class StopRequest(StrictModel):
    """Stop until released, or release."""

    release: bool = False
    reason: ShortText = ""


class StopReply(StrictModel):
    """Whether the stop is latched now, and why."""

    stopped: bool
    reason: str = ""


class ResetRequest(StrictModel):
    """Make the present pose the origin of odom."""


class ResetReply(StrictModel):
    """Whether it was done; ``reason`` says why not."""

    ok: bool
    reason: str = ""


class GateStatus(StrictModel):
    """The gate's state, on ``rover/gate`` at each change and ten times a second.

    ``driver`` holds the lease ("" = nobody). ``held`` names what holds the rover at zero now ("" = nothing, a
    command is in force). ``ended`` names what took the last lease away ("" = it is held, or was given back).
    Counters are since the bridge's start, by name of the gate's reason: commands ``dropped``, commands
    ``limited``, and ``stops``, how often a command in force was cut off.
    """

    driver: str = ""
    driver_name: str = ""
    held: str = ""
    ended: str = ""
    stop_reason: str = ""
    """The words of a latched stop."""
    accepted: int = 0
    dropped: dict[str, int] = Field(default_factory=dict)
    limited: dict[str, int] = Field(default_factory=dict)
    stops: dict[str, int] = Field(default_factory=dict)


class DriverStatus(StrictModel):
    """What the driving process says of itself on ``rover/status``."""

    state: str
    reason: str = ""
    policy: str = ""
    course: str = ""
    tick: int = 0
    t_s: float = 0.0
    overruns: int = 0


ModelT = TypeVar("ModelT", bound=BaseModel)


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
