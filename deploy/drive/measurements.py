"""Decoding of samples: from received bytes to values with their measurement time."""

from collections import deque
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from deploy.drive.clock import NS, StampClock
from deploy.drive.link import Inbox, Mailbox
from deploy.drive_records import SampleRef
from rover_ncp.core.errors import FormatError
from rover_ncp.core.geometry import Pose, Velocity, distance, wrap_angle
from rover_ncp.core.messages import COURSE_FRAME, read_imu, read_odometry, read_pose


@dataclass(frozen=True)
class Sample:
    """Odometry in its own frame; its values are not checked and may be NaN."""

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
        """Number of samples that could not be decoded."""

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


@dataclass(frozen=True)
class SeenPose:
    """An external pose in the course's frame with its covariance (3, 3); its values are not checked."""

    pose: Pose
    covariance: NDArray[np.float64]
    ref: SampleRef


class PoseIntake:
    """Takes external poses out of an inbox: they may come late, out of order, and stamped by any clock."""

    def __init__(self, inbox: Inbox) -> None:
        self._inbox = inbox
        self._stamps = StampClock(in_order=False)
        self.count = 0
        self.garbled = 0
        """Messages that were no pose, or one in another frame than the course's."""

    def take(self) -> list[SeenPose]:
        """Return what came since the last time; never waits."""
        taken = []
        for arrival in self._inbox.take():
            try:
                sample = read_pose(arrival.data)
            except FormatError:
                self.garbled += 1
                continue
            if sample.frame not in {"", COURSE_FRAME}:
                self.garbled += 1
                continue
            measured_ns = self._stamps.measured_ns(sample.stamp_ns, arrival.arrival_ns)
            ref = SampleRef.of(sample.stamp_ns, arrival.data, measured_ns, "pose")
            taken.append(SeenPose(sample.pose, sample.covariance, ref))
        self.count += len(taken)
        return taken


@dataclass(frozen=True)
class Turn:
    """A gyro reading: turn rate in rad/s, not checked."""

    rate: float
    ref: SampleRef


class GyroIntake:
    """Takes a gyro's readings out of an inbox; unreadable ones are ignored."""

    def __init__(self, inbox: Inbox) -> None:
        self._inbox = inbox
        self._stamps = StampClock()

    def take(self) -> list[Turn]:
        """Return what came since the last time; never waits."""
        taken = []
        for arrival in self._inbox.take():
            with suppress(FormatError):
                stamp_ns, rate = read_imu(arrival.data)
                measured_ns = self._stamps.measured_ns(stamp_ns, arrival.arrival_ns)
                taken.append(Turn(rate, SampleRef.of(stamp_ns, arrival.data, measured_ns, "imu")))
        return taken


def middle(poses: Sequence[Pose]) -> Pose:
    """Return the median of poses that should be the same, heading by heading around the last."""
    x, y, theta = np.array(poses).T
    last = float(theta[-1])
    turned = np.median([wrap_angle(angle - last) for angle in theta.tolist()])
    return Pose(float(np.median(x)), float(np.median(y)), wrap_angle(last + float(turned)))


class StillWatch:
    """Detects when the rover has stood still for long enough, by its odometry alone."""

    def __init__(self, still_s: float, still_m: float, still_rad: float) -> None:
        self._still_ns, self._still_m, self._still_rad = round(still_s * NS), still_m, still_rad
        self._since: deque[Sample] = deque()

    def see(self, sample: Sample) -> bool:
        """Add odometry; return True once nothing has moved for the whole time."""
        self._since.append(sample)
        while len(self._since) > 1 and not self._close(self._since[0].pose, sample.pose):
            self._since.popleft()
        return sample.ref.measured_ns - self._since[0].ref.measured_ns >= self._still_ns

    def _close(self, a: Pose, b: Pose) -> bool:
        return distance(a, b) <= self._still_m and abs(wrap_angle(a.theta - b.theta)) <= self._still_rad
