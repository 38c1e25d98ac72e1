"""How long the machine kept a loop from running, for the answer to a fault line (``late_ns``)."""

import math
import time


class Lateness:
    """The longest delay of a loop's turns since `take`. The turn that is under way counts.

    So a delay before a fault line is reported with the line, and never counts as one after it.
    """

    def __init__(self) -> None:
        self._due_s, self._longest_s = math.inf, 0.0

    def begin(self, allowed_s: float) -> None:
        """Begin a turn that should end within ``allowed_s``."""
        self._due_s = time.monotonic() + allowed_s

    def end(self) -> None:
        """End the turn."""
        self._longest_s = max(self._longest_s, time.monotonic() - self._due_s)

    def take(self) -> float:
        """Return the longest delay so far in s, and start over."""
        self.end()
        longest_s, self._longest_s = self._longest_s, 0.0
        self._due_s = max(self._due_s, time.monotonic())
        return longest_s
