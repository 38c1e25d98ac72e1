"""One message of a recording, and the encoding that its file declares."""

import functools
import struct
from dataclasses import dataclass, field
from typing import NamedTuple

from rover_ncp.wire.cdr import definition

# A Header begins with its stamp, right behind CDR's own four bytes: int32 seconds, uint32 nanoseconds.
CDR_ORDERS = (b"\x00\x00", b"\x00\x01")
CDR_STAMP, CDR_STAMP_BIG = struct.Struct("<iI"), struct.Struct(">iI")


class Layout(NamedTuple):
    """Encoding of a channel's bytes as its file declares it: MCAP's Channel, with its Schema."""

    encoding: str
    metadata: tuple[tuple[str, str], ...]
    schema: tuple[str, str, bytes] | None
    """Name, encoding and text; None where a channel needs none."""


@dataclass(frozen=True, slots=True)
class Recorded:
    """One message: its bytes, when it arrived here and when it was sent (ns since the epoch)."""

    topic: str
    type: str
    data: bytes
    log_ns: int
    publish_ns: int
    sequence: int = 0
    layout: Layout | None = field(default=None, compare=False, repr=False)
    """None for ours: ``type`` in CDR. A file may hold what we cannot read; `rewrite` keeps it as it is."""


@functools.cache
def _begins_with_header(ros_type: str) -> bool:
    fields = [line for line in definition(ros_type).splitlines() if line and not line.startswith("#")]
    return fields[0].split() == ["std_msgs/Header", "header"]


def header_stamp_ns(ros_type: str, data: bytes) -> int | None:
    """Return the stamp of a message whose first field is a Header; None when there is none to read."""
    if not _begins_with_header(ros_type) or len(data) < CDR_STAMP.size + 4 or data[:2] not in CDR_ORDERS:
        return None
    seconds, nanoseconds = (CDR_STAMP if data[1] else CDR_STAMP_BIG).unpack_from(data, 4)
    return int(seconds * 1_000_000_000 + nanoseconds)
