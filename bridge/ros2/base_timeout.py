"""The base timeout of a ROS 2 robot: what its description says of it, and its measurement. Pure."""

import math
from dataclasses import dataclass
from enum import Enum, auto

from bridge.base import BaseReport
from rover_ncp.core.geometry import STANDSTILL, Velocity
from rover_ncp.wire.protocol import TimeoutState

SPEED_M_S, DRIVE_S = 0.1, 1.5
"""How fast and how long the robot drives before the silence."""
MAX_SILENT_S = 5.0
"""Longest silence: a base that has not halted by then has no timeout."""
STILL_S = 1.5
"""A base that has moved less than `STILL_M` and `STILL_RAD` for so long has halted.

It is also the time in which the stop button that halted it is reported, as by a Husky A200 (1 Hz).
"""
STILL_M, STILL_RAD = 0.01, 0.02
STILL_SHARE = 0.2
"""Largest reported speed of a base that has halted, as a share of the command: its pose may be frozen."""
MIN_REPORTS = 5
"""Fewest reports from which a halt is concluded."""


@dataclass(frozen=True)
class TimeoutRecord:
    """Time in s after which a robot halts without commands, by its description; None = not measured.

    ``unsafe`` is whether every driver may drive all the same (--no-base-watchdog).
    """

    described_s: float | None = None
    unsafe: bool = False

    @property
    def state(self) -> TimeoutState:
        """How the time is known."""
        return TimeoutState.UNKNOWN if self.described_s is None else TimeoutState.MEASURED

    @property
    def refusal(self) -> str:
        """Why no driver may drive; "" if every driver may."""
        if self.unsafe or self.described_s is not None:
            return ""
        return (
            "it is not known whether the robot halts by itself when its commands stop; measure it with "
            "'rover-ncp bridge --measure-timeout', or give the bridge --no-base-watchdog"
        )

    @property
    def note(self) -> str:
        """Text for the log at each start."""
        if self.described_s is not None:
            words = f"the robot halts {self.described_s:g} s after its last command (measured)"
        else:
            words = self.refusal or "it is not known whether the robot halts by itself"
        return f"if this bridge dies: {words}"


class Phase(Enum):
    """Where a measurement is."""

    DRIVE = auto()
    """The robot gets commands to drive forward."""
    SILENT = auto()
    """The robot gets nothing."""
    HALTED = auto()
    """The robot halted ``timeout_s`` after its last command."""
    DRIVES_ON = auto()
    """The robot did not halt within `MAX_SILENT_S`."""
    NO_MOTION = auto()
    """The robot did not follow its commands, so nothing was measured."""


class TimeoutMeasurement:
    """Drives a robot forward, sends nothing, and measures when it is still, by its odometry.

    The caller ends the measurement if the gate holds the robot: then zeros or a hazard halted it.
    """

    def __init__(self, began_s: float, speed_m_s: float = SPEED_M_S, speed_mean_s: float = 0.0) -> None:
        """``speed_mean_s`` is the time over which the robot averages the speeds that it reports."""
        self.phase = Phase.DRIVE
        self.timeout_s = math.nan
        """At most the time to drive `STILL_M` too long, never too short."""
        self._speed = speed_m_s
        self._began_s, self._mean_s = began_s, speed_mean_s
        self._motion = STANDSTILL
        self._newest: BaseReport | None = None
        self._anchor: BaseReport | None = None
        self._still_since_s, self._reports = began_s, 0

    @property
    def command(self) -> Velocity:
        """Command for the gate: in the silence, which sends nothing, the motion that the robot reports.

        So fence, sonars and frozen odometry end a measurement too.
        """
        if self.phase is Phase.DRIVE:
            return Velocity(self._speed, 0.0)
        return self._motion if self.phase is Phase.SILENT else STANDSTILL

    def tick(self, now: float, last_sent_s: float) -> None:
        """Let time pass. ``last_sent_s`` is when the robot was sent its last command."""
        if self.phase is Phase.DRIVE and now - self._began_s >= DRIVE_S:
            moves = self._anchor is not None and now - self._still_since_s < DRIVE_S / 2
            self.phase = Phase.SILENT if moves else Phase.NO_MOTION
            self._began_s = last_sent_s
        elif self.phase is Phase.SILENT and now - self._began_s >= MAX_SILENT_S + self._mean_s:
            self.phase = Phase.DRIVES_ON

    def take(self, report: BaseReport, now: float) -> None:
        """Take a report that arrived ``now``."""
        before, self._newest, anchor = self._newest, report, self._anchor
        # A mean speed goes on for a while after the pose has stopped to change.
        repeated = before is not None and _pose(before) == _pose(report)
        self._motion = STANDSTILL if repeated else Velocity(report.v, report.omega)
        still = anchor is not None and (
            math.hypot(report.x - anchor.x, report.y - anchor.y) < STILL_M
            and abs(report.theta - anchor.theta) < STILL_RAD
        )
        if not still:
            self._anchor, self._still_since_s, self._reports = report, now - report.age_s, 0
        self._reports += 1
        halted = (
            abs(report.v) < STILL_SHARE * self._speed
            and now - self._still_since_s >= STILL_S
            and self._reports >= MIN_REPORTS
        )
        if self.phase is Phase.SILENT and halted:
            self.phase = Phase.HALTED
            moved_s = STILL_M / self._speed
            self.timeout_s = max(self._still_since_s - self._began_s, 0.0) + moved_s


def _pose(report: BaseReport) -> tuple[float, float, float]:
    return report.x, report.y, report.theta
