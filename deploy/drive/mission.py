"""What a drive drives, as the control loop sees it: `CourseMission` and `Docking` implement it."""

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from deploy.drive.controller import Tick
from deploy.drive.measurements import Sample
from deploy.estimator.estimator import Estimate, Estimator
from deploy.place.outcome import DockResult, Evidence
from deploy.place.place import Proof
from deploy.place.room import Room
from rover_ncp.core.geometry import Pose
from rover_ncp.course.scoring import Verdict
from rover_ncp.robot.lasting_error import UNDECLARED, LastingError


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
        *,
        room: Room | None = None,
    ) -> None:
        """Begin at rest at time ``t``, at ``pose``, where odometry stands at ``odometry``.

        ``room`` is that of the gate's fence. Raises SafetyStop if there is no way from that pose.
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
