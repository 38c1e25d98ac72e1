"""The motion of a check: commands under the lease, and what arrives meanwhile as samples."""

import math
from collections.abc import Callable
from typing import NamedTuple

from deploy.comparisons import Samples
from deploy.drive.link import Link
from deploy.drive.measurements import Measurement, Measurements
from deploy.drive.safety_monitor import SafetyMonitor, revoked
from deploy.drive.signed_lease import ACCEPTED_S, NOT_ACCEPTED
from rover_ncp.core.clock_offset import NS_PER_S
from rover_ncp.core.errors import SafetyStop
from rover_ncp.core.geometry import STANDSTILL, Pose, Velocity
from rover_ncp.core.process import Clock
from rover_ncp.wire.messages import OdometrySample
from rover_ncp.wire.protocol import UNNAMED

MOVE_S, PERIOD_S = 1.5, 0.05
WAIT_S = 0.02
"""How long a check waits for odometry before it takes what else arrived."""
STALL_S = 0.3
"""A longer time between two commands is a stall of this computer."""
REST_S = 1.0
"""Rest after a motion that sensors are compared on: the lag of a sensor may be so long."""


class Moved(NamedTuple):
    """First and last report of a motion, distance and turn by the reported speeds, and all samples."""

    before: OdometrySample
    after: OdometrySample
    by_speed: Velocity
    samples: Samples


class Moves:
    """Commands one robot, and takes what arrives."""

    def __init__(
        self, link: Link, measurements: Measurements, monitor: SafetyMonitor, clock: Clock, *, name: str
    ) -> None:
        self._link, self._measurements, self._monitor = link, measurements, monitor
        self._clock, self._name = clock, name
        self._samples = Samples()
        self.pose_frames: list[str] = []
        self.pose_ages_s: list[float] = []
        """Arrival minus stamp of each pose, by this computer's wall clock."""

    @property
    def newest(self) -> Measurement[OdometrySample]:
        """The newest odometry."""
        assert self._measurements.newest is not None  # a step before received some
        return self._measurements.newest

    def until(self, condition: Callable[[], bool], timeout_s: float) -> bool:
        """Take what arrives until a condition holds; return False if it did not in time."""
        self._take(0.0)
        return self._monitor.until(condition, timeout_s, self._take)

    def listen(self, seconds: float) -> Samples:
        """Return what arrives in some time, without commands."""
        self._samples = Samples()
        self.until(lambda: False, seconds)
        return self._samples

    def move(self, velocity: Velocity) -> Moved:
        """Command a velocity for a while. Raises SafetyStop if the gate accepts no commands."""
        self._samples = Samples([_timed(self.newest)])
        return self.command(velocity)

    def rest(self) -> None:
        """Command a rest, whose samples are added to those of the motion before."""
        self.command(STANDSTILL, REST_S)

    def command(self, velocity: Velocity, seconds: float = MOVE_S) -> Moved:
        """Command a velocity, again after a stall of this computer, which is no fault of the robot."""
        try:
            return self._command(velocity, seconds)
        except SafetyStop as stop:
            if stop.rule != NOT_ACCEPTED:
                raise
        self.until(lambda: False, ACCEPTED_S)  # without fresh odometry the gate refuses the motors
        gate = self._link.gate
        if gate.lease not in {0, self._link.lease.number}:
            raise SafetyStop("another-driver", f"{gate.driver_name or UNNAMED} holds the lease")
        if not gate.lease and gate.ended != "lease-lapsed":
            raise revoked(gate)  # the cause is at the robot: only a person starts again
        self._link.request_motors(self._name)
        self.until(lambda: False, ACCEPTED_S)
        return self._command(velocity, seconds)

    def _command(self, velocity: Velocity, seconds: float) -> Moved:
        """Command a velocity for some time. Raises SafetyStop without accepted commands, or after a stall."""
        before = newest = self.newest
        way = turn = 0.0
        due = now = self._clock.monotonic()
        end = due + seconds
        while now < end:
            sent = now
            self._link.command(velocity)
            self._link.lease.check(self._link.gate, self._clock.monotonic_ns())
            due += PERIOD_S
            self.until(lambda: False, max(0.0, due - self._clock.monotonic()))
            last, newest = newest, self.newest
            span_s = (newest.ref.measured_ns - last.ref.measured_ns) / NS_PER_S
            way += newest.sample.velocity.v * span_s
            turn += newest.sample.velocity.omega * span_s
            if (now := self._clock.monotonic()) - sent > STALL_S:
                raise SafetyStop(NOT_ACCEPTED, f"this computer sent no command for {now - sent:.2f} s")
        return Moved(before.sample, newest.sample, Velocity(way, turn), self._samples)

    def _take(self, timeout_s: float) -> None:
        """Take what arrived, and wait for odometry if none did; values that are not finite are left out."""
        samples = self._samples
        odometry = self._measurements.odometry(min(timeout_s, WAIT_S))
        if odometry is not None and all(map(math.isfinite, odometry.sample.pose)):
            samples.odometry.append(_timed(odometry))
        for reading in self._measurements.gyro():
            if math.isfinite(reading.sample.rate):
                samples.gyro.append((reading.ref.measured_ns / NS_PER_S, reading.sample.rate))
        epoch_ns = self._clock.time_ns() - self._clock.monotonic_ns()
        for pose in self._measurements.poses():
            if all(map(math.isfinite, pose.sample.pose)):
                samples.poses.append((pose.ref.measured_ns / NS_PER_S, pose.sample.pose))
                self.pose_frames.append(pose.sample.frame)
                self.pose_ages_s.append((epoch_ns + pose.arrival_ns - pose.sample.stamp_ns) / NS_PER_S)


def _timed(odometry: Measurement[OdometrySample]) -> tuple[float, Pose]:
    return odometry.ref.measured_ns / NS_PER_S, odometry.sample.pose
