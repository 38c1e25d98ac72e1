"""What a drive drives: a course or a docking, behind one protocol. No I/O, no clock."""

import math
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from deploy.drive.config import DriveConfig
from deploy.drive.controller import Controller, Tick
from deploy.drive.measurements import Sample
from deploy.estimator.estimator import Estimate, Estimator
from deploy.place.outcome import DockResult, Evidence
from deploy.place.place import Proof
from rover_ncp.core.errors import SafetyStop
from rover_ncp.core.geometry import ORIGIN, Pose, wrap_angle
from rover_ncp.course.scoring import Verdict
from rover_ncp.robot.lasting_error import UNDECLARED, LastingError
from rover_ncp.wire.messages import OdometrySample, PoseSample, TurnSample


class Mission(Protocol):
    """What the control loop needs of a course or of a docking. Times are seconds on one clock."""

    @property
    def proof(self) -> Proof | None:
        """The proof of a docking; None for a mission that uses no evidence."""

    @property
    def leading_end(self) -> int:
        """The end of the rover that touches a dock: 0 is the front, 1 the rear."""

    @property
    def frame(self) -> str:
        """The frame of all poses."""

    @property
    def estimator(self) -> Estimator:
        """The estimator of the rover's pose."""

    @property
    def over(self) -> bool:
        """Whether the drive ends before its last tick."""

    @property
    def words(self) -> str:
        """The stage of a docking for people; "" for a course."""

    def start_pose(self, seen: Pose | None, complaint: str) -> Pose:
        """Return the pose to start from. Raises SafetyStop if the drive must not begin there.

        ``seen`` is the pose by external poses, and ``complaint`` says why those that arrived were not used.
        """

    def start(
        self,
        odometry: Pose,
        t: float,
        pose: Pose,
        covariance: NDArray[np.float64] | None = None,
        lasting: LastingError = UNDECLARED,
    ) -> None:
        """Begin at rest at time ``t``, at ``pose``, where odometry stands at ``odometry``.

        Raises SafetyStop if there is no way from that pose.
        """

    def take(self, sample: Sample, t: float) -> None:
        """Give the estimator a sample that was measured at time ``t``."""

    def tick(self, index: int, t: float, evidence: Evidence | None = None) -> Tick:
        """Run tick ``index`` at time ``t``."""

    def record_estimate(self, index: int, t: float) -> Estimate:
        """Record the estimate at time ``t`` for the verdict, without a command."""

    def on_contact(self, *, other_end: bool) -> bool:
        """Return whether the drive continues after contact, for which the gate revoked the lease.

        ``other_end`` is whether the end that does not lead was touched.
        """

    def verdict(self, contact: str) -> Verdict:
        """Judge the drive; ``contact`` is the contact that the base reported, in words."""

    def result(self, reason: str) -> DockResult | None:
        """Return how a docking ended, None for a course; ``reason`` is why the drive ended."""


class CourseMission:
    """A course, driven by one controller."""

    proof, leading_end, over, words = None, 0, False, ""

    def __init__(self, controller: Controller, config: DriveConfig) -> None:
        self._controller, self._config = controller, config
        self.frame = config.pose_frame

    @property
    def estimator(self) -> Estimator:
        """The controller's estimator."""
        return self._controller.estimator

    def start_pose(self, seen: Pose | None, complaint: str) -> Pose:
        """Return the start pose. Raises SafetyStop if the rover is where no rate of parking is known."""
        if seen is None:
            return ORIGIN
        (x, y, theta), config = seen, self._config
        far = round(max(abs(x), abs(y)), 3) > config.start_m
        if far or abs(wrap_angle(theta)) > config.start_rad:
            found = f"x {x:.2f} m, y {y:.2f} m and {math.degrees(theta):.0f}°"
            limits = f"±{config.start_m:g} m and ±{math.degrees(config.start_rad):.0f}°"
            raise SafetyStop(
                "start-pose",
                f"external poses show the rover at {found} from the course's start (limit {limits}); "
                "place it nearer, or give a course that starts there",
            )
        return seen

    def start(
        self,
        odometry: Pose,
        t: float,
        pose: Pose,
        covariance: NDArray[np.float64] | None = None,
        lasting: LastingError = UNDECLARED,
    ) -> None:
        """Begin as `Controller.start`."""
        self._controller.start(odometry, t, pose, covariance, lasting)

    def take(self, sample: Sample, t: float) -> None:
        """Give the estimator a sample."""
        take(self.estimator, sample, t)

    def tick(self, index: int, t: float, evidence: Evidence | None = None) -> Tick:
        """Run a tick of the controller."""
        return self._controller.tick(index, t)

    def record_estimate(self, index: int, t: float) -> Estimate:
        """Record the estimate at time ``t`` for the verdict."""
        return self._controller.record_estimate(index, t)

    def on_contact(self, *, other_end: bool) -> bool:
        """Return False: contact ends the drive."""
        return False

    def verdict(self, contact: str) -> Verdict:
        """Judge the drive by the estimates; a rover that touched something has not parked."""
        return self._controller.verdict().with_contact(contact)

    def result(self, reason: str) -> None:
        """Return None: nothing was docked."""


def take(estimator: Estimator, sample: Sample, t: float) -> None:
    """Give the estimator a sample that was measured at time ``t``."""
    match sample:
        case OdometrySample(_, pose, velocity):
            estimator.odometry(pose, velocity, t)
        case PoseSample(_, _, pose, covariance):
            estimator.external(pose, covariance, t)
        case TurnSample(_, rate):
            estimator.gyro(rate, t)
