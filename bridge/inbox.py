"""Queue of all arrivals for the bridge's one loop: bytes, commands, queries, errors of threads.

Threads only add arrivals, each with its time, and never decide anything.
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
"""Beyond this number, messages of peers are dropped: 0.1 s of a flood of 20,000 a second."""


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
    """A thread failed because of an error in this program."""

    error: BaseException


Arrival: TypeAlias = Opened | Received | Broken | Sampled | Asked | Crashed


class Inbox:
    """A queue from many threads to one loop. Times are the monotonic clock's, in seconds."""

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._arrivals: deque[tuple[float, Arrival]] = deque()
        self.flooded = 0
        """Commands and queries dropped because the queue was full."""

    def put(self, arrival: Arrival) -> None:
        """Add an arrival. A full queue drops messages of peers, but never bytes or errors."""
        with self._changed:
            if isinstance(arrival, Sampled | Asked) and len(self._arrivals) >= ROOM:
                self.flooded += 1
                return
            self._arrivals.append((time.monotonic(), arrival))
            self._changed.notify()

    def take(self, timeout_s: float) -> list[tuple[float, Arrival]]:
        """Return all arrivals in order; wait at most ``timeout_s`` for the first."""
        with self._changed:
            if not self._arrivals and timeout_s > 0.0:
                self._changed.wait(timeout_s)
            taken = list(self._arrivals)
            self._arrivals.clear()
            return taken
