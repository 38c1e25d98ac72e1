"""One message of a recording, and the times of messages on a clock that is never set.

The stamps of a recording are of the wall clock, which may be set during a drive. Each control tick also holds
the driver's monotonic clock; between ticks the order of the file decides. Without ticks, a stamp far before
the previous one means that the clock was set back.
"""

import functools
import struct
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Annotated

from pydantic import BaseModel, Field

from rover_ncp.core.clock_offset import NS_PER_S
from rover_ncp.core.errors import FormatError
from rover_ncp.wire.cdr import definition
from rover_ncp.wire.messages import read_text
from rover_ncp.wire.protocol import parse_json

TICKS_TOPIC = "deploy/ticks"
SET_NS = 1_000_000_000
"""A stamp so long before the previous message is one of a clock that was set back."""
LOOKAHEAD = 2_000
"""Messages between two ticks at most; a tick is due every 0.1 s."""
KEPT = 4
"""Former settings of the clock that later messages may still have; one may be dated at the drive's start."""
_MAX_NS = 1 << 63

# A Header begins with its stamp, right behind CDR's own four bytes: int32 seconds, uint32 nanoseconds.
CDR_ORDERS = (b"\x00\x00", b"\x00\x01")
CDR_STAMP, CDR_STAMP_BIG = struct.Struct("<iI"), struct.Struct(">iI")


@dataclass(frozen=True, slots=True)
class Recorded:
    """One message: its bytes, when it arrived here and when it was sent (ns since the epoch)."""

    topic: str
    type: str
    """ROS type of the bytes, which are CDR; empty for bytes of another encoding."""
    data: bytes
    log_ns: int
    publish_ns: int
    sequence: int = 0


@functools.cache
def _begins_with_header(ros_type: str) -> bool:
    fields = [line for line in definition(ros_type).splitlines() if line and not line.startswith("#")]
    return fields[0].split() == ["std_msgs/Header", "header"]


def header_stamp_ns(ros_type: str, data: bytes) -> int | None:
    """Return the stamp of a message whose first field is a Header; None when there is none to read."""
    if not _begins_with_header(ros_type) or len(data) < CDR_STAMP.size + 4 or data[:2] not in CDR_ORDERS:
        return None
    seconds, nanoseconds = (CDR_STAMP if data[1] else CDR_STAMP_BIG).unpack_from(data, 4)
    return int(seconds * NS_PER_S + nanoseconds)


_TimeNs = Annotated[int, Field(strict=True, ge=0, lt=_MAX_NS)]


class _Tick(BaseModel):
    """A tick's moment, on the driver's monotonic clock and on the wall clock."""

    now_ns: _TimeNs
    wall_ns: _TimeNs


def steady(messages: Iterable[Recorded]) -> Iterator[Recorded]:
    """Yield messages in their order, with log_ns and publish_ns as if the wall clock had never been set.

    The clock is the wall clock at the first message.
    """
    clock = _Clock()
    waiting: list[Recorded] = []
    for message in messages:
        waiting.append(message)
        tick = _tick(message)
        if tick is not None or len(waiting) == LOOKAHEAD:
            yield from clock.placed(waiting, tick)
            waiting = []
    yield from clock.placed(waiting, None)


def _tick(message: Recorded) -> _Tick | None:
    if message.topic != TICKS_TOPIC:
        return None
    try:
        return parse_json(_Tick, read_text(message.data))
    except FormatError:
        return None


class _Clock:
    """Differences of the wall clock from the steady one, as far as the file was read."""

    def __init__(self) -> None:
        self._shifts = [0]
        """Wall minus steady time, in ns; the newest first, the first one last."""
        self._monotonic_ns: int | None = None
        """Monotonic minus steady time."""
        self._newest_ns = 0
        """Steady time of the newest message."""
        self._began = False

    def placed(self, messages: list[Recorded], tick: _Tick | None) -> Iterator[Recorded]:
        """Yield messages of which ``tick`` is the last, if it is not None."""
        if self._monotonic_ns is None or tick is None:
            for message in messages:
                yield self._continued(message)
            if tick is not None:
                self._begin(messages[-1], tick)
            return
        until = max(tick.now_ns - self._monotonic_ns, self._newest_ns)
        shifts = [self._shifts[0], tick.wall_ns - until, self._shifts[-1]]
        for message in messages:
            log_ns = self._between(message.log_ns, shifts, until)
            yield _at(message, log_ns, self._between(message.publish_ns, shifts, until))
        self._newest_ns = until
        self._shifts = [shifts[1], self._shifts[-1]]

    def _begin(self, message: Recorded, tick: _Tick) -> None:
        """Take the first tick as the common moment of the clocks."""
        # A recorder keeps its log times steady; then only they tell the moment.
        wall_ns = tick.wall_ns if abs(message.log_ns - tick.wall_ns) < SET_NS else message.log_ns
        self._monotonic_ns = tick.now_ns - (wall_ns - self._shifts[0])
        self._newest_ns = wall_ns - self._shifts[0]
        self._shifts = [tick.wall_ns - self._newest_ns, self._shifts[-1]]

    def _between(self, wall_ns: int, shifts: list[int], until_ns: int) -> int:
        """Return the steady time that is nearest to the time between two ticks."""
        times = [wall_ns - shift for shift in shifts]
        return min(times, key=lambda time: max(self._newest_ns - time, time - until_ns, 0))

    def _continued(self, message: Recorded) -> Recorded:
        """Return a message that follows the previous one without a tick."""
        if not self._began:
            self._began, self._newest_ns = True, message.log_ns
        shift = self._nearest(message.log_ns, self._newest_ns)
        if message.log_ns - shift < self._newest_ns - SET_NS:
            shift = message.log_ns - self._newest_ns
            self._shifts = [shift, *self._shifts[:KEPT], self._shifts[-1]]
        log_ns = message.log_ns - shift
        self._newest_ns = max(self._newest_ns, log_ns)
        return _at(message, log_ns, message.publish_ns - self._nearest(message.publish_ns, log_ns))

    def _nearest(self, wall_ns: int, time_ns: int) -> int:
        """Return the shift by which a stamp is nearest to a steady time."""
        return min(self._shifts, key=lambda shift: abs(wall_ns - shift - time_ns))


def _at(message: Recorded, log_ns: int, publish_ns: int) -> Recorded:
    if (log_ns, publish_ns) == (message.log_ns, message.publish_ns):
        return message
    return replace(message, log_ns=log_ns, publish_ns=publish_ns)
