"""The start of a drive: the rover must stand still, and external poses may show where it stands."""

import math
from bisect import bisect_left, insort
from collections import deque
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from deploy.drive.config import DriveConfig
from deploy.drive.link import Link
from deploy.drive.measurements import Measurement, Measurements
from deploy.drive.safety_monitor import SafetyMonitor
from deploy.estimator.estimator import completed
from deploy.estimator.inputs import still_limits
from rover_ncp.core.clock_offset import NS_PER_S
from rover_ncp.core.errors import AnotherDriver, NoPose, SafetyStop
from rover_ncp.core.geometry import Pose, near, wrap_angle
from rover_ncp.core.process import Clock
from rover_ncp.course.scoring import pose_error
from rover_ncp.wire.messages import OdometrySample, PoseSample

STEADY_S, MIN_POSES = 0.5, 3
"""Time and number of external poses after which a rover that turns has its tags in the image."""
MAX_SCATTER = 6.0
"""Largest variance of poses over the told one that chance explains: 1 in a million of six poses."""


class StartPose(NamedTuple):
    """A start pose by external poses, with its covariance (3, 3)."""

    pose: Pose
    covariance: NDArray[np.float64]
    unexplained: Pose
    """Standard deviations by which the poses scatter more than they tell, as those of two localisers."""


class StartDetector:
    """Waits for a rover that stands still by its odometry, and collects external poses meanwhile."""

    def __init__(self, link: Link, measurements: Measurements, config: DriveConfig, clock: Clock) -> None:
        self._link, self._measurements = link, measurements
        self._config, self._clock = config, clock
        self._standing: deque[Measurement[OdometrySample]] = deque()
        """Odometry of the rover at one place, from the first sample there."""
        self._poses: list[Measurement[PoseSample]] = []
        """Usable external poses of the time in which the rover must stand, in the order of measurement."""
        noise = still_limits(config.estimator)
        self._still_m = max(config.still_m, noise.position_m)
        self._still_rad = max(config.still_rad, noise.heading_rad)

    def wait(self, monitor: SafetyMonitor) -> Measurement[OdometrySample]:
        """Return the odometry at the start. Raises SafetyStop, NoPose, AnotherDriver, KeyboardInterrupt."""
        config = self._config
        if not monitor.until(self._stands, config.still_wait_s):
            words = f"the rover does not stand still for {config.still_s:g} s"
            newest = self._measurements.newest
            if newest is None or self._clock.monotonic_ns() - newest.arrival_ns > config.still_s * NS_PER_S:
                words = f"the bridge at {self._link.robot} sends no odometry: {monitor.why_no_odometry()}"
            raise SafetyStop("not-standing", words)
        if config.pose == "required" and not monitor.until(
            lambda: self._stands() and bool(self._poses), config.pose_wait_s
        ):
            unreadable = self._measurements.complaints.get("pose", "")
            raise NoPose(
                f"no external pose of the rover arrived on 'pose' within {config.pose_wait_s:g} s"
                + (f" that can be used: {unreadable}" if unreadable else "")
            )
        assert self._measurements.newest is not None  # it stands, so there was a sample
        return self._measurements.newest

    def pose(self) -> StartPose | None:
        """Return the start pose by external poses, if there are any."""
        if not self._poses:
            return None
        poses = [seen.sample.pose for seen in self._poses]
        told = [self._completed(seen) for seen in self._poses]
        median = median_pose(poses)
        scatter = np.mean([np.square(pose_error(pose, median)) for pose in poses], axis=0)
        expected = np.diag(np.mean(told, axis=0))
        unexplained = np.where(scatter > MAX_SCATTER * expected, scatter - expected, 0.0)
        # The covariance of the last one: errors of these poses are not independent.
        return StartPose(median, told[-1] + np.diag(unexplained), Pose(*np.sqrt(unexplained).tolist()))

    def _completed(self, seen: Measurement[PoseSample]) -> NDArray[np.float64]:
        covariance = completed(seen.sample.covariance, self._config.estimator)
        assert covariance is not None  # others are not collected
        return covariance

    @property
    def sees_steadily(self) -> bool:
        """Whether external poses have come for `STEADY_S`, by more than two."""
        if len(self._poses) < MIN_POSES:
            return False
        return self._poses[-1].ref.measured_ns - self._poses[0].ref.measured_ns >= STEADY_S * NS_PER_S

    def _stands(self) -> bool:
        gate = self._link.gate
        if gate.lease and not self._config.dry_run:
            # A rover that another driver drives does not stand still until that driver releases the lease.
            holder = gate.driver_name or "a driver without a name"
            raise AnotherDriver(
                f"the bridge at {self._link.robot} refuses the motors: {holder} holds the lease"
            )
        if self._config.pose != "none":
            self.collect_poses()
        measured = self._measurements.odometry(0)
        if measured is None:
            return False
        self._standing.append(measured)
        while len(self._standing) > 1 and not self._same_place(
            self._standing[0].sample.pose, measured.sample.pose
        ):
            self._standing.popleft()
        return measured.ref.measured_ns - self._standing[0].ref.measured_ns >= round(
            self._config.still_s * NS_PER_S
        )

    def _same_place(self, a: Pose, b: Pose) -> bool:
        return near(a, b, self._still_m, self._still_rad)

    def collect_poses(self) -> None:
        """Take the external poses that arrived; those that can be used are kept for `still_s`."""
        for seen in self._measurements.poses():
            valid = completed(seen.sample.covariance, self._config.estimator) is not None
            if valid and all(map(math.isfinite, seen.sample.pose)):
                insort(self._poses, seen, key=_measured_ns)
        oldest = self._clock.monotonic_ns() - self._config.still_s * NS_PER_S
        del self._poses[: bisect_left(self._poses, oldest, key=_measured_ns)]


def _measured_ns(seen: Measurement[PoseSample]) -> float:
    return seen.ref.measured_ns


def median_pose(poses: Sequence[Pose]) -> Pose:
    """Return the median of poses that should be the same, heading by heading around the last."""
    x, y, theta = np.array(poses).T
    last = float(theta[-1])
    turned = np.median([wrap_angle(angle - last) for angle in theta.tolist()])
    return Pose(float(np.median(x)), float(np.median(y)), wrap_angle(last + float(turned)))
