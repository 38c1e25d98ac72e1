"""Time sources of the loops: Python's ``time`` module, or a virtual clock that has its methods."""

from typing import Protocol


class Clock(Protocol):
    """A clock that never goes back, the wall clock, and waiting."""

    def monotonic(self) -> float:
        """Return s, from any zero."""

    def monotonic_ns(self) -> int:
        """Return the same in ns."""

    def time_ns(self) -> int:
        """Return ns since the epoch."""

    def sleep(self, seconds: float, /) -> None:
        """Wait."""
