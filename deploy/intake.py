"""Odometry on its way in: from bytes in a mailbox to samples with the moment of their measurement."""

from collections import deque
from dataclasses import dataclass

from deploy.clock import NS, StampClock
from deploy.link import Mailbox
from deploy.ticks import SampleRef
from rover_ncp.core.errors import FormatError
from rover_ncp.core.geometry import Pose, Velocity, distance, wrap_angle
from rover_ncp.core.messages import read_odometry

__all__ = ["Intake", "Sample", "StillWatch"]


@dataclass(frozen=True)
class Sample:
    """Odometry in its own frame; its values may be anything, NaN included."""

    pose: Pose
    velocity: Velocity
    ref: SampleRef
    arrival_ns: int


class Intake:
    """Takes odometry out of a mailbox."""

    def __init__(self, mailbox: Mailbox) -> None:
        self._mailbox = mailbox
        self._stamps = StampClock()
        self.newest: Sample | None = None
        self.count = 0
        self.garbled = 0
        """Samples whose bytes were no odometry."""

    def take(self, timeout_s: float) -> Sample | None:
        """Return the newest odometry not yet taken; wait for it at most ``timeout_s``."""
        arrival = self._mailbox.take(timeout_s)
        if arrival is None:
            return None
        try:
            odometry = read_odometry(arrival.data)
        except FormatError:
            self.garbled += 1
            return None
        measured_ns = self._stamps.measured_ns(odometry.stamp_ns, arrival.arrival_ns)
        ref = SampleRef.of(odometry.stamp_ns, arrival.data, measured_ns)
        self.newest = Sample(odometry.pose, odometry.velocity, ref, arrival.arrival_ns)
        self.count += 1
        return self.newest


class StillWatch:
    """Says when the rover has stood still for long enough, by its odometry alone."""

    def __init__(self, still_s: float, still_m: float, still_rad: float) -> None:
        self._still_ns, self._still_m, self._still_rad = round(still_s * NS), still_m, still_rad
        self._since: deque[Sample] = deque()

    def see(self, sample: Sample) -> bool:
        """Take in odometry; True once nothing has moved for the whole time."""
        self._since.append(sample)
        while len(self._since) > 1 and not self._close(self._since[0].pose, sample.pose):
            self._since.popleft()
        return sample.ref.measured_ns - self._since[0].ref.measured_ns >= self._still_ns

    def _close(self, a: Pose, b: Pose) -> bool:
        return distance(a, b) <= self._still_m and abs(wrap_angle(a.theta - b.theta)) <= self._still_rad
