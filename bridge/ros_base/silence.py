"""What is known of a robot when its commands stop, and its measurement. Pure."""

import math
from dataclasses import dataclass, replace

from rover_ncp.core.protocol import TimeoutState

_REMEDIES = {
    TimeoutState.NONE: "to drive it, the bridge needs --no-base-watchdog",
    TimeoutState.UNKNOWN: "put it on blocks and run 'rover-ncp check', or give the bridge --no-base-watchdog",
}
MOST_ALLOWED_S = 2.5
"""A base that takes longer to halt counts as one without a timeout: a Pioneer takes 2 s."""
MOST_SILENT_S = 5.0
"""A base that has not halted after this time without commands has no timeout."""
HALTED = 0.5
"""A base has halted when its speed is below this share of what it was."""
LATE_S = 1.5
"""A halt counts after this time: the stop that caused it may be reported late, as by a Husky A200 (1 Hz)."""


@dataclass(frozen=True)
class Silence:
    """``unsafe`` is whether every driver may drive although the base may not halt (--no-base-watchdog)."""

    state: TimeoutState = TimeoutState.UNKNOWN
    timeout_s: float | None = None
    unsafe: bool = False

    def measured(self, timeout_s: float | None) -> "Silence":
        """Return what is known after a measurement; None = it did not halt."""
        halts = timeout_s is not None and timeout_s <= MOST_ALLOWED_S
        return replace(self, state=TimeoutState.MEASURED if halts else TimeoutState.NONE, timeout_s=timeout_s)

    @property
    def refusal(self) -> str:
        """Why the robot is not driven unless the request says ``unchecked``; "" if it is."""
        if self.unsafe or self.state is TimeoutState.MEASURED:
            return ""
        known = f"the robot {self._known} by itself when its commands stop"
        return f"{known}; {_REMEDIES[self.state]}"

    @property
    def note(self) -> str:
        """What a user has to know at each start."""
        if self.state is TimeoutState.MEASURED:
            return f"if this bridge dies, the robot halts after {self.timeout_s:.1f} s (measured)"
        remedy = "" if self.unsafe else f"; {_REMEDIES[self.state]}"
        return f"if this bridge dies, the robot {self._known}{remedy}"

    @property
    def _known(self) -> str:
        return "does not halt" if self.state is TimeoutState.NONE else "is not known to halt"


class Measurement:
    """The time from a robot's last command to its halt, while it gets none.

    The result counts from ``counts_s`` on. A stop or a loss of the base until then may have halted the robot;
    the caller then discards the measurement.
    """

    def __init__(self, began_s: float, speed: float) -> None:
        self._began_s, self._speed = began_s, abs(speed)
        self.silent = True
        """Whether the robot must get no command."""
        self.timeout_s: float | None = None
        """None = it did not halt."""
        self.counts_s = math.inf

    def update(self, speed: float, now: float) -> None:
        """Take the robot's speed in m/s."""
        silent_s = now - self._began_s
        if self.silent and abs(speed) < HALTED * self._speed:
            self.silent, self.timeout_s, self.counts_s = False, silent_s, now + LATE_S
        elif self.silent and silent_s >= MOST_SILENT_S:
            self.silent, self.counts_s = False, now


@dataclass(frozen=True)
class NotStored:
    """A result could not be stored."""

    reason: str
