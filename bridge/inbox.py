"""Queue of all arrivals for the bridge's one loop: drivers, the base, errors of threads.

Threads only add arrivals, each with its time, and never decide anything.
"""

import threading
import time
from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

MAX_MESSAGES = 2048
"""Beyond this number, messages of one origin are dropped: 0.1 s of a flood of 20,000 a second."""


@dataclass(frozen=True)
class CommandMessage:
    """A command from Zenoh, with its attachment, if it has one."""

    payload: bytes
    attachment: bytes | None = None


@dataclass(frozen=True)
class Query:
    """A query on one of the bridge's keys, with its attachment, if any.

    ``reply`` answers with JSON, ``refuse`` with the reason why the query cannot be read. ``source`` is the
    Zenoh id that the peer states, "" if it states none; nothing proves it.
    """

    name: str
    payload: bytes
    attachment: bytes | None
    reply: Callable[[bytes], None]
    refuse: Callable[[str], None]
    source: str = ""


@dataclass(frozen=True)
class RobotMessage:
    """A message of a robot's topic, for its base. ``source`` identifies its publisher, if that is known."""

    topic: str
    payload: bytes
    arrived_s: float
    source: bytes | None = None


@dataclass(frozen=True)
class ThreadError:
    """A thread failed because of an error in this program."""

    error: BaseException


class Inbox:
    """A queue from many threads to one loop. Times are the monotonic clock's, in seconds.

    What is none of the classes above comes from the base's thread, for the base alone.
    """

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._arrivals: deque[tuple[float, object]] = deque()
        self._waiting = Counter[tuple[type, str]]()
        """Number of messages in the queue, by origin."""
        self.flooded = 0
        """Messages dropped because too many of their origin waited."""

    def put(self, arrival: object) -> None:
        """Add an arrival. A flood of one origin drops no other messages, bytes or errors."""
        origin = _origin(arrival)
        with self._changed:
            if origin is not None:
                if self._waiting[origin] >= MAX_MESSAGES:
                    self.flooded += 1
                    return
                self._waiting[origin] += 1
            self._arrivals.append((time.monotonic(), arrival))
            self._changed.notify()

    def guarded(self, callback: Callable[[Any], None]) -> Callable[[Any], None]:
        """Return a callback for Zenoh that hands its errors to the loop; Zenoh would print them and go on."""

        def call(item: Any) -> None:
            try:
                callback(item)
            except Exception as error:
                self.put(ThreadError(error))

        return call

    def take(self, timeout_s: float) -> list[tuple[float, object]]:
        """Return all arrivals in order; wait at most ``timeout_s`` for the first."""
        with self._changed:
            if not self._arrivals and timeout_s > 0.0:
                self._changed.wait(timeout_s)
            taken = list(self._arrivals)
            self._arrivals.clear()
            self._waiting.clear()
            return taken


def _origin(arrival: object) -> tuple[type, str] | None:
    """Return the key or topic that a message came from; None for bytes and errors."""
    match arrival:
        case CommandMessage():
            return CommandMessage, ""
        case Query(name):
            return Query, name
        case RobotMessage(topic):
            return RobotMessage, topic
        case _:
            return None
