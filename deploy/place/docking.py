"""A docking: its stages, tick by tick. No I/O, no clock.

Rules of this file:

1. One estimator, in the frame of the external poses, goes through all stages. Where poses are lost, odometry
   carries on.
2. The gate stops a rover that touches something, and revokes the lease, as always. `judge` alone declares
   the rover *docked*.
3. The place was taught by the same source of poses, whose heading may have a constant error, as by a
   camera's mount. The rover must show the taught heading, and drives in the direction without that error.
4. A rover that is not docked after its last try stands at the staging pose. After a safety rule's stop it
   stands where it is.
"""

import math
from collections import deque
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from deploy.drive.config import DriveConfig
from deploy.drive.controller import Controller, Tick
from deploy.drive.measurements import Sample
from deploy.estimator.estimator import Estimate, Estimator
from deploy.place.judge import (
    STAGED_M,
    STAGED_RAD,
    Approached,
    Judgement,
    approached,
    judge_approach,
    judge_drive,
    judge_report,
)
from deploy.place.outcome import DockError, DockResult, Evidence, Stage
from deploy.place.place import AT_PLACE_M
from deploy.place.plan import FAR_M, Fenced, Way, approach, in_the_way, retreat, tail, to_staging
from deploy.place.room import Room
from rover_ncp.circuit.policy import Policy
from rover_ncp.core.errors import ConfigError, SafetyStop
from rover_ncp.core.geometry import STANDSTILL, Pose, Velocity, distance, near, turned
from rover_ncp.course.course import TICK_S
from rover_ncp.course.scoring import Verdict
from rover_ncp.course.slowdown import slowdown
from rover_ncp.robot.lasting_error import UNDECLARED, LastingError
from rover_ncp.wire.messages import PoseSample

UNSEEN = 0.1, 0.1, math.radians(10.0)
"""Standard deviations of the place of a rover that is to be undocked and that no external pose shows."""
CONTACT_S = 0.5
"""External poses of so long before contact count for its place; the rover has moved 2 cm meanwhile."""
BOUNCE_S = 2.0
"""How long a bumper may open and close as the rover begins to back out; it can only drive away."""
KEPT_POSES = 300
MAX_STAGINGS = 5
"""Ways to the staging pose in one drive."""


class _LegEstimator(Estimator):
    """The estimates of an estimator for a way: with the heading in which the rover drives.

    For a way that is driven backward they are those of the rover's tail: turned by 180°.
    """

    def __init__(self, estimator: Estimator, heading_error_rad: float, *, backward: bool) -> None:
        self._shown, self._heading_error_rad, self._backward = estimator, heading_error_rad, backward

    def at(self, t: float) -> Estimate:
        found = self._shown.at(t)
        found = replace(found, pose=self.driven(found.pose))
        if not self._backward:
            return found
        return replace(
            found,
            velocity=Velocity(-found.velocity.v, found.velocity.omega),
            rotation_center_m=-found.rotation_center_m,
        )

    def driven(self, pose: Pose) -> Pose:
        """Return a pose as the estimates have it."""
        pose = turned(pose, -self._heading_error_rad)
        return tail(pose) if self._backward else pose


class Docking:
    """The mission to drive into a place or out of it, by the drive's settings.

    ``staging`` drives to the staging pose, ``dock`` from there; they must have the same neurons.
    """

    def __init__(self, config: DriveConfig, staging: Policy, dock: Policy) -> None:
        assert config.place is not None
        if staging.circuit.neurons != dock.circuit.neurons:
            raise ConfigError("the two policies of the drive", ["they have different neurons"])
        self.place, self._undock, self._config = config.place, config.undock, config
        self.frame, self.proof = config.pose_frame, self.place.proof
        self.leading_end = int(self.place.backward)
        self._slower = 1.0 if config.described is None else max(1.0, slowdown(config.described))
        self._staging, self._dock = staging, dock
        self.estimator = Estimator(config.estimator)
        self._heading_error_rad, self._lane = 0.0, self.place
        """The poses' heading error as the present way assumes it, and the place as the rover drives to it."""
        self._further_m = 0.0
        """How far a next approach goes on: what the last one was short of."""
        self._approach, self._retreat = (
            self._leg(dock, way(self.place, self._slower)) for way in (approach, retreat)
        )
        self._leg(staging, self._retreat.way)  # a policy that drives no rover is refused now
        self._now: _Leg = self._retreat
        self._began = self._index = 0
        """Tick of the present leg's begin, and the present tick."""
        self.stage, self.over = Stage.NONE, False
        self._tries = self._stagings = 0
        self._waits_since, self._known_reports = math.inf, 0
        self._poses: deque[tuple[float, Pose]] = deque(maxlen=KEPT_POSES)
        """Times and values of the newest external poses."""
        self._potentials = self._approach.controller.potentials
        self._judgement = Judgement(DockError.UNKNOWN)
        self._estimate: Estimate | None = None
        self._approached = Approached()
        self._room: Room | None = None

    def start_pose(self, seen: Pose | None, complaint: str) -> Pose:
        """Return the start pose. A rover that is to be undocked stands in its place if no pose shows it."""
        if seen is None and not self._undock:
            self._end(DockError.FAILED_TO_DETECT_DOCK, complaint)
            raise SafetyStop("start-pose", complaint)
        if seen is None and complaint:
            raise SafetyStop("start-pose", f"external poses arrive, but none can be used: {complaint}")
        return self.place.goal if seen is None else seen

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
        """Begin at ``pose``. Raises SafetyStop if there is no way from there."""
        self._room = room
        unseen = np.diag(np.square(UNSEEN)) if covariance is None else covariance
        self.estimator.start(pose, t, odometry, unseen, lasting)
        off, out_m = self.place.errors(pose), self.place.out_m(pose)
        in_line = abs(off.lateral_m) <= STAGED_M and abs(off.yaw_rad) <= STAGED_RAD
        # Whatever it begins with, the rover may drive the approach, or all of it backward.
        problem = in_the_way(self.place, self._approach.way, self._config.described)
        if problem:
            self._end(DockError.FAILED_TO_CONTROL, problem)
        elif in_line and AT_PLACE_M < out_m < self.place.staging_m - STAGED_M:
            # It may stand in the dock: it does not turn on the spot there.
            self._begin(Stage.CONTROLLING if self._undock else Stage.RETRY, self._way_out(out_m), 0, pose)
        elif in_line and abs(out_m) <= AT_PLACE_M and self._undock:
            self._begin(Stage.CONTROLLING, self._retreat, 0, pose)
        elif in_line and abs(out_m) <= AT_PLACE_M:
            self._tries = 1
            self._begin(Stage.CONTROLLING, self._approach, -self._approach.way.course.ticks, pose)
        elif self._undock:
            self._end(
                DockError.FAILED_TO_CONTROL, f"the rover does not stand in {self.place.name}, but {off} of it"
            )
        else:
            self._drive_to_staging(0, pose)
        if self.over:
            raise SafetyStop("start-pose", self._judgement.why)

    def take(self, sample: Sample, t: float) -> None:
        """Give the estimator a sample, and keep external poses for the judge."""
        if isinstance(sample, PoseSample) and all(map(math.isfinite, sample.pose)):
            self._poses.append((t, sample.pose))
        self.estimator.take(sample, t)

    def on_contact(self, *, other_end: bool) -> bool:
        """Return whether contact ends a try, and not the drive: no dock is at the other end."""
        if other_end:
            return False
        if self._undock or self.stage is Stage.RETRY:
            return self._index - self._began <= BOUNCE_S / TICK_S
        # In the dock a bumper may open and close again.
        return self.stage in {Stage.CONTROLLING, Stage.WAIT_FOR_CHARGE}

    @property
    def words(self) -> str:
        """The stage for people."""
        return f"{self.stage}, try {max(self._tries, 1)} of {self.place.retries + 1}"

    def tick(self, index: int, t: float, evidence: Evidence | None = None) -> Tick:
        """Run tick ``index`` of the drive at time ``t``."""
        estimate = self.record_estimate(index, t)
        self._advance(index, t, estimate, evidence or Evidence())
        if self.over or self.stage is Stage.WAIT_FOR_CHARGE:
            return Tick(index, index * TICK_S, estimate, STANDSTILL, self._potentials)
        tick = self._now.controller.tick(index - self._began, t)
        self._potentials, (v, omega) = tick.potentials, tick.command
        command = Velocity(-v if self._now.way.backward else v, omega)
        return Tick(index, index * TICK_S, estimate, command, tick.potentials)

    def record_estimate(self, index: int, t: float) -> Estimate:
        """Return the estimate at time ``t``."""
        self._index, self._estimate = index, self.estimator.at(t)
        return self._estimate

    def _advance(self, index: int, t: float, estimate: Estimate, evidence: Evidence) -> None:
        """Go on to the next stage if the present one is over."""
        ended = index - self._began >= self._now.way.course.ticks
        if self._config.dry_run and ended and self._began >= 0:
            way = self._now.way.course
            words = f"the dry run ends after the first way ({way.name}, {way.horizon_s:.0f} s), not driven"
            self._end(DockError.UNKNOWN, words)
            return
        match self.stage:
            case Stage.NAV_TO_STAGING_POSE if ended:
                self._staged(index, estimate.pose)
            case Stage.CONTROLLING if self._undock and ended and self._stands_at_staging(estimate.pose):
                self._end(DockError.NONE)
            case Stage.CONTROLLING if self._undock and ended:
                self._end(DockError.FAILED_TO_CONTROL, "the rover is not at the staging pose")
            case Stage.CONTROLLING if not self._undock and (evidence.contact or ended):
                self._judge_approach(index, t, evidence)
            case Stage.WAIT_FOR_CHARGE:
                found = judge_report(self.place.proof, evidence, self._known_reports, t, self._waits_since)
                self._decide(index, estimate.pose, found)
            case Stage.RETRY if ended and (self._judgement.gives_up or self._tries > self.place.retries):
                self.over = True
            case Stage.RETRY if ended:
                self._staged(index, estimate.pose)

    def _judge_approach(self, index: int, t: float, evidence: Evidence) -> None:
        """Judge the end of an approach, or begin to wait for a report."""
        leg, pose, contact = self._approach.controller, self.estimator.at(t).pose, evidence.contact
        leg.record_estimate(index - self._began, t)
        verdict = leg.verdict(self.estimator.lasting_covariance)
        since = t - (CONTACT_S if contact else self._approach.way.course.parked.still_s)
        newest = [seen for measured, seen in self._poses if measured >= since]
        self._approached = end = approached(self.place, pose, verdict.probability, newest)
        found = judge_approach(self.place, pose, verdict, end, contact)
        if end.by_estimate is not None and not contact:
            short_m = end.by_estimate.longitudinal_m * (1.0 if self.place.backward else -1.0)
            limit_m = self.place.position_m
            self._further_m = min(max(self._approach.further_m + short_m, -limit_m), limit_m)
        if found is None:
            self._waits_since, self._known_reports = t, evidence.reports
            self.stage = Stage.WAIT_FOR_CHARGE
        self._decide(index, pose, found)

    def _decide(self, index: int, pose: Pose, judgement: Judgement | None) -> None:
        """End a docking that is judged as docked; after a miss, go back to the staging pose."""
        if judgement is None:
            return
        self._judgement = judgement
        if judgement.error is DockError.NONE:
            self.over = True
        else:
            self._learn()
            self._begin(Stage.RETRY, self._way_out(self.place.out_m(pose)), index, pose)

    def _learn(self) -> None:
        """Plan the ways of the place by what is known better than before; the rover stands."""
        learnt = self.estimator.heading_error_rad, self._further_m
        if learnt != (self._heading_error_rad, self._approach.further_m):
            self._heading_error_rad, further_m = learnt
            self._lane = self.place.driven(self._heading_error_rad)
            way = approach(self._lane, self._slower, further_m)
            self._approach = self._leg(self._dock, way)._replace(further_m=further_m)
            self._retreat = self._leg(self._dock, retreat(self._lane, self._slower))

    def _staged(self, index: int, pose: Pose) -> None:
        """Begin an approach, or drive to the staging pose anew if the rover is too far from it."""
        self._learn()
        if self._stands_at_staging(pose):
            problem = in_the_way(self._lane, self._approach.way, self._config.described)
            if problem:
                self._end(DockError.FAILED_TO_CONTROL, problem)
                return
            self._tries += 1
            self._begin(Stage.CONTROLLING, self._approach, index, pose)
            return
        if self._stagings < MAX_STAGINGS:
            self._drive_to_staging(index, pose)
        else:
            self._end(DockError.FAILED_TO_STAGE, "the rover is not at the staging pose: too many tries")

    def _drive_to_staging(self, index: int, pose: Pose) -> None:
        """Begin the way to the staging pose, or end the docking if there is none."""
        way, problem, away = None, "", distance(pose, self._lane.staging)
        if away > FAR_M:
            problem = f"{away:.2f} m from the staging pose (at most {FAR_M:g} m)"
        else:
            # A moving rover cannot wait for a search among detours.
            way, problems = to_staging(
                self._lane,
                turned(pose, -self._heading_error_rad),
                self._config.described,
                self._slower,
                detours=self.stage is Stage.NONE,
                sight=self._config.sight,
                fenced=None if self._room is None else self._fenced(self._room),
            )
            problem = "; ".join(map(str, problems))
        if way is None:
            self._end(DockError.FAILED_TO_STAGE, f"the rover is not at the staging pose: {problem}")
            return
        self._stagings += 1
        self._begin(Stage.NAV_TO_STAGING_POSE, self._leg(self._staging, way), index, pose)

    def _fenced(self, room: Room) -> Fenced:
        """Return what a plan needs to know of the fence; before the first way the room has the turn gain."""
        estimator, gain = self.estimator, room.turn_gain if self.stage is Stage.NONE else None
        return Fenced(room, estimator.odometry_pose, gain or estimator.turn_gain, self._approach.way)

    def _end(self, error: DockError, why: str = "") -> None:
        self.over, self._judgement = True, Judgement(error, why)

    def _begin(self, stage: Stage, leg: "_Leg", index: int, pose: Pose) -> None:
        self.stage, self._now, self._began = stage, leg, index
        leg.controller.begin(leg.estimator.driven(pose))

    def _way_out(self, out_m: float) -> "_Leg":
        """Return the way to the staging pose from so far out of the place."""
        if out_m <= AT_PLACE_M:
            return self._retreat
        out_m = min(out_m, self.place.staging_m - AT_PLACE_M)
        return self._leg(self._dock, retreat(self._lane, self._slower, out_m))

    def _leg(self, policy: Policy, way: Way) -> "_Leg":
        c, (course, reference) = self._config, way.of_tail() if way.backward else (way.course, way.reference)
        controller = Controller(policy, course, c.estimator, c.rover, c.described, reference=reference)
        controller.estimator = estimator = _LegEstimator(
            self.estimator, self._heading_error_rad, backward=way.backward
        )
        return _Leg(way, controller, estimator)

    def _stands_at_staging(self, pose: Pose) -> bool:
        return near(turned(pose, -self._heading_error_rad), self._lane.staging, STAGED_M, STAGED_RAD)

    def verdict(self, contact: str) -> Verdict:
        """Return the verdict. A contact ended a try, or backing out of the place; it is no failure."""
        assert self._estimate is not None  # the drive had a tick
        goal = self.estimator.lasting_covariance
        return judge_drive(self.place, self._undock, self._estimate, goal, self._ending())

    def _ending(self) -> Judgement:
        """Return how the docking ended; an earlier miss is not why a drive was stopped."""
        return self._judgement if self.over else Judgement(DockError.UNKNOWN)

    def result(self, reason: str) -> DockResult:
        """Return the result; ``reason`` is why a drive ended that did not come to a judgement."""
        code, why, _ = self._ending()
        success, at = code is DockError.NONE, "elsewhere"
        if success and not self._undock:
            at = "place"
        elif self._estimate is not None and self._stands_at_staging(self._estimate.pose):
            at = "staging pose"
        return DockResult(
            place=self.place.name,
            undock=self._undock,
            success=success,
            error_code=code,
            error_msg="" if success else why or reason or "the time is over",
            num_retries=max(self._tries - 1, 0),
            stage=self.stage,
            at=at,
            proof=self.place.proof.value,
            **self._approached._asdict(),
        )


class _Leg(NamedTuple):
    """A way with the controller that drives it."""

    way: Way
    controller: Controller
    estimator: _LegEstimator
    further_m: float = 0.0
    """How far the reference of an approach goes on after the place."""
