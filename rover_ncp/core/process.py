"""Clock and termination signals of a process; resources that a ``with`` block closes."""

import os
import signal
import sys
import threading
import time
from abc import ABC, abstractmethod
from types import FrameType
from typing import Any, ClassVar, Protocol, Self

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
"""Signals that end a command."""


class Clock(Protocol):
    """Python's ``time`` module, or a virtual clock that has its methods."""

    def monotonic(self) -> float:
        """Return s, from any zero."""

    def monotonic_ns(self) -> int:
        """Return ns, from the same zero."""

    def time_ns(self) -> int:
        """Return ns since the epoch."""

    def sleep(self, seconds: float, /) -> None:
        """Wait."""


def suspended_s() -> float:
    """Return how long this computer has been suspended since its start, in s; 0 if it is not Linux."""
    if sys.platform != "linux":
        return 0.0
    return time.clock_gettime(time.CLOCK_BOOTTIME) - time.clock_gettime(time.CLOCK_MONOTONIC)


class ClosedAtExit(ABC):
    """Something that the end of a ``with`` block closes."""

    @abstractmethod
    def close(self) -> None:
        """Close it."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


class Interrupts:
    """Record SIGINT, SIGTERM and SIGHUP instead of ending at once: the rover has to be stopped first.

    Signals that were ignored before stay ignored, such as SIGHUP (a closed terminal) under ``nohup``.
    """

    earlier: ClassVar[list[int]] = []
    """Signals that this process received outside of any ``with`` block of this class."""

    def __init__(self) -> None:
        self.received: list[int] = []
        self._before: dict[signal.Signals, Any] = {}

    def __enter__(self) -> Self:
        for number in SIGNALS:
            if signal.getsignal(number) is not signal.SIG_IGN:
                self._before[number] = signal.signal(number, self._note)
        return self

    def __exit__(self, *error: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    @property
    def raised(self) -> bool:
        """Whether any of these signals was received, or earlier: a library may have dropped its exception."""
        return bool(self.received or self.earlier)

    def _note(self, number: int, frame: FrameType | None) -> None:
        self.received.append(number)


def interrupt_on_signals() -> None:
    """Raise KeyboardInterrupt at each signal that ends a command; ignored signals stay ignored."""

    def interrupt(number: int, frame: FrameType | None) -> None:
        Interrupts.earlier.append(number)
        raise KeyboardInterrupt

    for number in SIGNALS:
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, interrupt)


PARENT_PIPE = "ROVER_NCP_PARENT_PIPE"
"""Variable with the descriptor of a pipe whose other end only the parent holds."""


def end_with_parent() -> None:
    """Interrupt this process when its parent ends, also when that is killed, if the parent gave a pipe."""
    if not (number := os.environ.pop(PARENT_PIPE, "")):
        return
    os.set_inheritable(int(number), False)

    def wait() -> None:
        while os.read(int(number), 1):
            pass
        os.kill(os.getpid(), signal.SIGTERM)

    threading.Thread(target=wait, daemon=True, name="parent").start()
