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

MOVE_S, PERIOD_S = 1.5, 0.05
WAIT_S = 0.02
"""How long a check waits for odometry before it takes what else arrived."""
OF_A_STALL = frozenset({"lease-lapsed", "no-base"})
"""Reasons for which the gate ends a lease while this computer stalls; others have a cause at the robot."""
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
        return self._try_twice(velocity, MOVE_S)

    def rest(self) -> None:
        """Command a rest, whose samples are added to those of the motion before."""
        self._try_twice(STANDSTILL, REST_S)

    def _try_twice(self, velocity: Velocity, seconds: float) -> Moved:
        """Command a velocity, again after a stall of this computer, which is no fault of the robot."""
        try:
            return self.command(velocity, seconds)
        except SafetyStop as stop:
            if stop.rule != NOT_ACCEPTED:
                raise
        self.until(lambda: False, ACCEPTED_S)  # without fresh odometry the gate refuses the motors
        gate = self._link.gate
        if not gate.lease and gate.ended not in OF_A_STALL:
            raise revoked(gate)  # after a hazard only a person starts again
        self._link.request_motors(self._name)
        self.until(lambda: False, ACCEPTED_S)
        return self.command(velocity, seconds)

    def command(self, velocity: Velocity, seconds: float = MOVE_S) -> Moved:
        """Command a velocity for some time."""
        before = newest = self.newest
        way = turn = 0.0
        due = self._clock.monotonic()
        end = due + seconds
        while self._clock.monotonic() < end:
            self._link.command(velocity)
            self._link.lease.check(self._link.gate, self._clock.monotonic_ns())
            due += PERIOD_S
            self.until(lambda: False, max(0.0, due - self._clock.monotonic()))
            last, newest = newest, self.newest
            span_s = (newest.ref.measured_ns - last.ref.measured_ns) / NS_PER_S
            way += newest.sample.velocity.v * span_s
            turn += newest.sample.velocity.omega * span_s
        self._link.lease.check(self._link.gate, self._clock.monotonic_ns())
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
