"""The header of ROS messages: stamp and frame."""

import functools
import logging
from typing import Any

from rover_ncp.core.clock_offset import NS_PER_S
from rover_ncp.core.errors import FormatError

_LOGGER = logging.getLogger("rover_ncp")


def header_of(stamp_ns: int, frame: str) -> dict[str, Any]:
    """Return a Header, as `encode` takes one.

    ROS has 32 bits for the seconds, until 2038-01-19. A later stamp becomes 0, which receivers take for a
    publisher without a clock.
    """
    seconds, nanoseconds = divmod(stamp_ns, NS_PER_S)
    if not -(2**31) <= seconds < 2**31:
        _warn_of_clock()
        seconds = nanoseconds = 0
    return {"stamp": {"sec": seconds, "nanosec": nanoseconds}, "frame_id": frame}


@functools.cache
def _warn_of_clock() -> None:
    _LOGGER.warning(
        "a clock is outside the time that ROS's stamps can hold (1901 to 2038-01-19): messages go out with "
        "the stamp 0; set the clock of this computer, or of the robot"
    )


def read_stamp_ns(header: Any) -> int:
    """Return the stamp of a Header, in ns. Raises FormatError."""
    if header.stamp.nanosec >= NS_PER_S:
        raise FormatError(f"a stamp of {header.stamp.nanosec} ns beyond its seconds, expected less than 10⁹")
    return int(header.stamp.sec) * NS_PER_S + int(header.stamp.nanosec)
