"""Where everything that arrives waits for the bridge's one loop: bytes, commands, queries, mishaps.

Threads only put things here, each with the moment of its arrival, and never decide anything.
"""

import threading
import time
from collections import deque
from dataclasses import dataclass
from typing import TypeAlias

import zenoh

from bridge.transport import Transport
from rover_ncp.core.errors import NoRobot

ROOM = 2048
"""What peers send beyond this is let fall: 0.1 s of a flood of 20,000 a second."""


@dataclass(frozen=True)
class Opened:
    """A line to the base is open."""

    transport: Transport


@dataclass(frozen=True)
class Received:
    """Bytes from the base."""

    data: bytes


@dataclass(frozen=True)
class Broken:
    """The line to the base, or the attempt to open it, failed."""

    error: NoRobot


@dataclass(frozen=True)
class Sampled:
    """A command from Zenoh, with the attachment and the time of sending it came with, if any."""

    payload: bytes
    attachment: bytes | None
    sent_ns: int | None


@dataclass(frozen=True)
class Asked:
    """A query on one of our keys, with the attachment it came with, if any."""

    name: str
    query: zenoh.Query
    payload: bytes
    attachment: bytes | None


@dataclass(frozen=True)
class Crashed:
    """A thread came upon an error that is nobody's but ours."""

    error: BaseException


Arrival: TypeAlias = Opened | Received | Broken | Sampled | Asked | Crashed


class Inbox:
    """Many threads put, one loop takes. Times are the monotonic clock's, in seconds."""

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._arrivals: deque[tuple[float, Arrival]] = deque()
        self.flooded = 0
        """Commands and queries that found no room."""

    def put(self, arrival: Arrival) -> None:
        """Add what arrived just now. What peers send may be let fall; bytes and mishaps never are."""
        with self._changed:
            if isinstance(arrival, Sampled | Asked) and len(self._arrivals) >= ROOM:
                self.flooded += 1
                return
            self._arrivals.append((time.monotonic(), arrival))
            self._changed.notify()

    def take(self, timeout_s: float) -> list[tuple[float, Arrival]]:
        """Return everything in the order of arrival; wait for something for ``timeout_s`` at most."""
        with self._changed:
            if not self._arrivals and timeout_s > 0.0:
                self._changed.wait(timeout_s)
            taken = list(self._arrivals)
            self._arrivals.clear()
            return taken
