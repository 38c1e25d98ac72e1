"""A slow turn on the spot, by which a rover that no external pose shows looks for tags.

It runs before the drive, under a lease of its own: the gate limits it as any other motion. Nothing here knows
where the rover is, so that it only turns, and only in the circle that its outline needs.
"""

import math
import statistics

from deploy.drive.config import DriveConfig
from deploy.drive.link import Link
from deploy.drive.measurements import Measurements
from deploy.drive.safety_monitor import SafetyMonitor
from deploy.drive.start import StartDetector
from deploy.estimator.settings import TURN_GAINS
from rover_ncp.core.clock_offset import NS_PER_S
from rover_ncp.core.files import DEFAULT_ROBOT
from rover_ncp.core.geometry import STANDSTILL, Velocity, wrap_angle
from rover_ncp.core.process import Clock
from rover_ncp.course.course import TICK_S
from rover_ncp.robot.dead_zone import DeadZone
from rover_ncp.robot.description import load_description

RATE_RAD_S = 0.2
"""A camera of 65° has tags in its image for 5 s at this rate."""
TURN_RAD = math.radians(390.0)
"""One turn, and what the rover needs to accelerate and to find tags that were at the image's edge."""
SAME_VIEW_RAD = math.radians(75.0)
"""A rover that turns back sees its tags again so long before it has turned once round."""
MARGIN_M = 0.03
"""Room around the circle of the outline."""
SLOW = 2.0
"""The turn may take so many times as long as at the commanded rate."""
POLL_S = 0.02
MIN_READINGS, MIN_TURN_RAD = 5, 0.3
"""Readings of a gyro before the turn, and odometry's turn, from which a turn gain is known."""


class Look:
    """A rover that turns on the spot and looks for tags. The lease is granted, and stays so."""

    def __init__(
        self,
        link: Link,
        measurements: Measurements,
        *,
        monitor: SafetyMonitor,
        detector: StartDetector,
        config: DriveConfig,
        clock: Clock,
    ) -> None:
        self._link, self._measurements, self._clock = link, measurements, clock
        self._monitor, self._detector = monitor, detector
        described = config.described or load_description(DEFAULT_ROBOT)
        self._needed_m = described.turning_radius_m + MARGIN_M
        self._rate = max(RATE_RAD_S, DeadZone(config.rover, config.described).least.omega)
        assert measurements.newest is not None  # the rover stood
        self._gyro, self._before = _GyroTurn(measurements), measurements.newest.sample
        self._turned = 0.0
        """By odometry, rad."""

    def around(self) -> tuple[str, float | None]:
        """Turn until external poses come steadily; return "" or, if none came, where the rover looked.

        Under a fence a rover that turned by more than half a turn turns back until it sees the tags from the
        other side: odometry, in which the fence lies, measures turns badly, and errors of the two turns
        cancel.

        The second value is the turn gain, true turn over odometry's, None if no gyro showed it. Raises
        SafetyStop and KeyboardInterrupt as a drive does.
        """
        try:
            words = self._turn(1.0)
            gain, turned = self._gain, self._true_turn
            if not words and self._link.gate.fence is not None and turned > math.pi:
                words = self._turn(-1.0, from_rad=turned - math.tau + SAME_VIEW_RAD)
        finally:
            self._link.command(STANDSTILL)
        return words, gain

    @property
    def _gain(self) -> float | None:
        return self._gyro.gain(self._turned)

    @property
    def _true_turn(self) -> float:
        """The turn, rad; by odometry if no gyro shows it."""
        return self._turned * (self._gain or 1.0)

    def _turn(self, side: float, from_rad: float | None = None) -> str:
        """Turn to a side until external poses come steadily; return "" or where the rover looked, in words.

        Poses count from the turn ``from_rad`` on, without it from the beginning.
        """
        clock, link, began = self._clock, self._link, self._turned
        next_ns = clock.monotonic_ns()
        until_ns = next_ns + round(SLOW * TURN_RAD / self._rate * NS_PER_S)
        while abs(self._turned - began) < TURN_RAD and clock.monotonic_ns() < until_ns:
            self._measure()
            self._monitor.check()
            if from_rad is None or side * (self._true_turn - from_rad) > 0.0:
                self._detector.collect_poses()
                if self._detector.sees_steadily:
                    return ""
            degrees = math.degrees(abs(self._turned - began))
            if (echo_m := link.nearest_echo_m(clock.monotonic_ns())) < self._needed_m:
                return (
                    f"the rover turned by {degrees:.0f}° and stopped: sonars show something {echo_m:.2f} m "
                    f"from its middle, and it needs {self._needed_m:.2f} m to turn"
                )
            if clock.monotonic_ns() >= next_ns:
                next_ns += round(TICK_S * NS_PER_S)
                command = Velocity(0.0, side * self._rate)
                self._monitor.check_command(command, self._before.velocity)
                link.command(command)
        return f"the rover turned by {degrees:.0f}° on the spot and looked in every direction"

    def _measure(self) -> None:
        if (newest := self._measurements.odometry(POLL_S)) is not None:
            self._turned += wrap_angle(newest.sample.pose.theta - self._before.pose.theta)
            self._before = newest.sample
        self._gyro.add(self._measurements)


class _GyroTurn:
    """The turn that a gyro shows of a rover that stood before."""

    def __init__(self, measurements: Measurements) -> None:
        rates = [reading.sample.rate for reading in measurements.gyro()]
        rates = [rate for rate in rates if math.isfinite(rate)]
        self._bias = statistics.median(rates) if len(rates) >= MIN_READINGS else math.nan
        self._turned, self._before_ns = 0.0, 0

    def add(self, measurements: Measurements) -> None:
        """Add the readings that arrived."""
        for sample, ref, _ in measurements.gyro():
            if self._before_ns:
                self._turned += (sample.rate - self._bias) * (ref.measured_ns - self._before_ns) / NS_PER_S
            self._before_ns = ref.measured_ns

    def gain(self, turned: float) -> float | None:
        """Return the turn over odometry's turn; None if it is not known, or beyond those of any robot."""
        gain = self._turned / turned if abs(turned) >= MIN_TURN_RAD else math.nan
        return gain if TURN_GAINS[0] <= gain <= TURN_GAINS[1] else None
