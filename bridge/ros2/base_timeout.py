"""The base timeout of a ROS 2 robot: what is known of it, and its measurement. Pure."""

import math
from dataclasses import dataclass, replace

from rover_ncp.robot.description import MAX_BASE_TIMEOUT_S
from rover_ncp.wire.protocol import TimeoutState

MAX_SILENT_S = 5.0
"""A base that has not halted after this time without commands has no timeout."""
HALTED = 0.5
"""A base has halted when its speed is below this share of what it was."""
STOP_DELAY_S = 1.5
"""A halt counts after this time: the stop that caused it may be reported late, as by a Husky A200 (1 Hz)."""
_UNSAFE = "give the bridge --no-base-watchdog"


@dataclass(frozen=True)
class TimeoutRecord:
    """The time after which a robot halts without commands, by its description or a measurement.

    Only the description's ``described_s`` shows that every driver may drive. ``unsafe`` is whether every
    driver may all the same (--no-base-watchdog).
    """

    described_s: float | None = None
    unsafe: bool = False
    measured: bool = False
    measured_s: float | None = None
    """Measured since the bridge's start, in s; None = the robot did not halt."""
    interrupted: bool = False
    """Whether the last measurement was ended before its result."""

    def after(self, measured_s: float | None) -> "TimeoutRecord":
        """Return what is known after a measurement; None = it did not halt."""
        return replace(self, measured=True, measured_s=measured_s, interrupted=False)

    @property
    def timeout_s(self) -> float | None:
        """The newest value in s; None = not known, or it does not halt."""
        return self.measured_s if self.measured else self.described_s

    @property
    def state(self) -> TimeoutState:
        """The result of the last measurement, or the description's."""
        return TimeoutState.UNKNOWN if self.interrupted else self._newest

    @property
    def refusal(self) -> str:
        """Why no driver but the check may drive; "" if every driver may."""
        if self.unsafe or (self.described_s is not None and self._newest is TimeoutState.MEASURED):
            return ""
        return "the robot {}; {}".format(*self._words)

    @property
    def note(self) -> str:
        """Text for the log at each start."""
        return f"if this bridge dies: {self.refusal or f'the robot {self._words[0]}'}"

    @property
    def _newest(self) -> TimeoutState:
        if self.timeout_s is not None and self.timeout_s <= MAX_BASE_TIMEOUT_S:
            return TimeoutState.MEASURED
        return TimeoutState.NONE if self.measured else TimeoutState.UNKNOWN

    @property
    def _words(self) -> tuple[str, str]:
        """What is known, and what to do before every driver may drive."""
        match self._newest:
            case TimeoutState.NONE:
                return "does not halt by itself when its commands stop", f"to drive it, {_UNSAFE}"
            case TimeoutState.UNKNOWN:
                return (
                    "is not known to halt by itself when its commands stop",
                    f"put it on blocks and run 'rover-ncp check', or {_UNSAFE}",
                )
            case _:
                known = f"halts {self.timeout_s:.1f} s after its last command (measured)"
                line = "the line that 'rover-ncp check' printed"
                return known, f"add {line} to its description and start the bridge anew"


class TimeoutMeasurement:
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
            self.silent, self.timeout_s, self.counts_s = False, silent_s, now + STOP_DELAY_S
        elif self.silent and silent_s >= MAX_SILENT_S:
            self.silent, self.counts_s = False, now
