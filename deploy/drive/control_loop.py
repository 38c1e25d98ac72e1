"""The drive itself: its phases in their order, the loop of ticks, and the reasons for its end.

Rules of this file:

1. At every end of a drive, the lease is released before anything else.
2. Odometry triggers the tick. When it does not come in time, the tick runs on prediction and is counted.
3. Before each command, a tick checks the bridge, the age of odometry, the estimator, the lease and the
   rover's response. If a check fails, the drive ends with the rule's name.
4. Only while DRIVING or SEARCHING may a command other than zero leave this process.
"""

import logging
import time
from collections.abc import Callable, Sequence
from enum import Enum
from functools import partial
from typing import Any

from deploy.drive.config import DriveConfig
from deploy.drive.link import Link
from deploy.drive.measurements import Measurement, Measurements, SampleRef
from deploy.drive.mission import Mission
from deploy.drive.rate_keeper import RateKeeper
from deploy.drive.records import StartRecord, TickRecord, numbers
from deploy.drive.safety_monitor import SafetyMonitor
from deploy.drive.search import Look
from deploy.drive.start import StartDetector
from deploy.drive.tick_messages import Publisher
from deploy.estimator.estimator import Estimate
from deploy.estimator.inputs import Acceptance
from deploy.place.outcome import Evidence
from deploy.place.place import Proof
from deploy.place.room import Room
from rover_ncp.core.bridge_lines import DOCKING
from rover_ncp.core.clock_offset import NS_PER_S
from rover_ncp.core.errors import NoPose, SafetyStop, UnreachableError
from rover_ncp.core.geometry import ORIGIN, Velocity
from rover_ncp.core.process import Clock
from rover_ncp.course.course import TICK_S
from rover_ncp.course.scoring import Parked, Verdict
from rover_ncp.robot.lasting_error import NOT_DECLARED, UNDECLARED
from rover_ncp.wire.messages import OdometrySample
from rover_ncp.wire.protocol import CONTACTS, DriverStatus

_LOGGER = logging.getLogger("rover_ncp")
POLL_S = 0.02


STANDING = Velocity(0.005, 0.01)
"""Slower estimates are those of a rover that stands, whose localisation may have nothing new to publish."""


class Phase(Enum):
    """Phase of a drive. From PARKED on they are final: another drive is another process."""

    WAITING = "waiting"
    """Waiting for the bridge, for the permission to command, and for a rover that stands still."""
    SEARCHING = "searching"
    """No external pose shows the rover: it turns on the spot, under a lease, to find its tags."""
    ARMED = "armed"
    """The start pose is known; the driver requests the motors."""
    DRIVING = "driving"
    """The driver holds the lease and the circuit drives, or in a dry run would."""
    PARKED = Parked.YES.value
    """The course's time is over; the rover is parked."""
    UNCERTAIN = Parked.UNCERTAIN.value
    """By the estimate the rover is parked, but the estimate is not sure enough."""
    ENDED = "ended"
    """The rover is not parked, or a termination signal was received."""
    FAULT = "fault"
    """A safety rule stopped the rover."""


class Drive:
    """One drive over an open link. ``run`` returns when it is over; the attributes hold the result.

    ``period_s`` is how long a tick lasts by the clock; a benchmark lets the course's time run faster. ``id``
    tells this drive from others. ``begin`` is called if the rover turns to find tags, before the first tick.
    """

    def __init__(
        self,
        link: Link,
        mission: Mission,
        publisher: Publisher,
        config: DriveConfig,
        interrupted: Callable[[], bool],
        *,
        clock: Clock = time,
        period_s: float = TICK_S,
        id: str = "",
        begin: Callable[[], None] = lambda: None,
    ) -> None:
        self._id, self._begin = id, begin
        self._period_ns = round(period_s * NS_PER_S)
        self._link, self.mission, self._publisher = link, mission, publisher
        self.config, self._clock = config, clock
        self._touched = False
        """Whether contact revoked the lease since the last tick, and the mission continues."""
        self._used: list[SampleRef] = []
        """Samples that the estimator got since the last tick."""
        self.measurements = Measurements(link, mission.frame)
        self._new_monitor = partial(SafetyMonitor, link, self.measurements, interrupted, config, clock)
        self.monitor = self._new_monitor()
        self._lasting = UNDECLARED
        """Lasting error of the external poses."""
        self.placed = False
        """Whether external poses gave the start pose."""
        self._poses_used, self._blind_ns, self._looked_ns = 0, 0, 0
        """External poses that the filter accepted, the motion since the last one, and the last look at it."""
        self._turn_gain: float | None = None
        """True turn over odometry's, if a turn before the start and a gyro showed it."""
        self.keeper = RateKeeper(self._period_ns, 0)
        self.phase = Phase.WAITING
        self.reason = ""
        self.stop: SafetyStop | None = None
        self.verdict: Verdict | None = None
        self.estimate: Estimate | None = None
        """The newest estimate of a tick."""
        self.latencies_ns: list[int] = []
        """From the arrival of odometry to its command on the wire."""

    @property
    def progress(self) -> str:
        """One line for people; another thread may read it."""
        keeper, newest = self.keeper, self.measurements.newest
        where = "odometry x {:.3f} y {:.3f} θ {:.3f}".format(*newest.sample.pose) if newest else ""
        return f"{self.phase.value}  t {keeper.index * TICK_S:.1f} s  {where}  overruns {keeper.overruns}"

    def wait(self) -> None:
        """Wait for bridge, permission and odometry. Raises as `SafetyMonitor.wait`."""
        self.monitor.wait(drives=not self.config.dry_run)

    def run(self) -> None:
        """Drive, after `wait`.

        Raises AnotherDriver, NotAuthorised and NoBridge when the motors are refused, NoPose when a required
        pose does not come. ``phase``, ``reason`` and ``stop`` hold the reason for a later end.
        """
        try:
            try:
                self._arm()
                self._drive()
            finally:
                self._link.release()
        except SafetyStop as stop:
            self.stop = stop
            self._enter(Phase.FAULT, str(stop))
        except KeyboardInterrupt:
            self._enter(Phase.ENDED, "interrupted")
        else:
            self.verdict = self.mission.verdict(self.monitor.contact)
            ends = {Parked.YES: Phase.PARKED, Parked.UNCERTAIN: Phase.UNCERTAIN, Parked.NO: Phase.ENDED}
            words = self.verdict.words
            reason = self._why_uncertain() if words is Parked.UNCERTAIN else self.verdict.reason
            self._enter(ends[words], reason)
        if (docked := self.mission.result(self.reason)) is not None:
            self._publisher.dock(docked)
        self._publisher.finish()

    def _arm(self) -> None:
        detector = StartDetector(self._link, self.measurements, self.config, self._clock)
        start = self._find_start(detector)
        self._enter(Phase.ARMED)
        found = detector.pose()
        seen, covariance, unexplained = found or (None, None, ORIGIN)
        self.placed = covariance is not None
        pose = self.mission.start_pose(seen, self._pose_complaint())
        self._start = start.ref
        """The controller's time is in seconds from this sample."""
        declared = self._link.lasting_error(self.config.pose_frame, self.config.described)
        self._lasting = declared.at_least(max(unexplained.x, unexplained.y), unexplained.theta)
        record = StartRecord(
            sample=start.ref,
            pose=pose,
            lasting=self._lasting,
            covariance=None if covariance is None else tuple(covariance.ravel().tolist()),
            room=self._room(),
        )
        self.mission.start(start.sample.pose, 0.0, pose, covariance, self._lasting, room=record.room)
        self._publisher.start(record, start.sample.pose)
        if not self.config.dry_run:
            self._request_motors()
        self._enter(Phase.DRIVING)

    def _find_start(self, detector: StartDetector) -> Measurement[OdometrySample]:
        """Return the odometry at the start; a rover that is to dock and that no pose shows looks around."""
        try:
            return detector.wait(self.monitor)
        except NoPose as missing:
            if self.config.place is None or self.config.dry_run:
                raise
            why = str(missing)
        self._enter(Phase.SEARCHING)
        looked = self._look_around(detector)
        if not looked:
            try:
                return detector.wait(self.monitor)
            except NoPose as lost:
                why, looked = str(lost), "poses came while the rover turned, and none since it stands"
        self.mission.start_pose(None, f"{why}; {looked}")
        raise NoPose(why)

    def _room(self) -> Room | None:
        """Return the room that the gate's fence leaves, None without a fence."""
        fence = self._link.gate.fence
        return None if fence is None else Room(fence=fence, turn_gain=self._turn_gain)

    def _look_around(self, detector: StartDetector) -> str:
        """Turn until poses come; return "" or where the rover looked. The turn has a lease of its own."""
        fence, newest = self._link.gate.fence, self.measurements.newest
        assert newest is not None  # the rover stood
        x, y, _ = newest.sample.pose
        if fence is not None and fence.outside(x, y) > 0.0:
            where = f"at x {x:.2f} m, y {y:.2f} m of odometry"
            return f"the rover did not turn: {where} it is outside the gate's fence"
        self._request_motors()
        self._begin()
        try:
            look = Look(
                self._link,
                self.measurements,
                monitor=self.monitor,
                detector=detector,
                config=self.config,
                clock=self._clock,
            )
            looked, self._turn_gain = look.around()
            return looked
        finally:
            self._link.release()
            self.monitor = self._new_monitor()

    def _pose_complaint(self) -> str:
        """Return why external poses that arrived cannot be used; "" if none arrived."""
        measurements = self.measurements
        if not measurements.taken["pose"] and "pose" not in measurements.complaints:
            return ""
        return measurements.complaints.get("pose", "too seldom, or without a valid covariance")

    def _why_uncertain(self) -> str:
        verdict, estimate = self.verdict, self.estimate
        assert verdict is not None and verdict.probability is not None and estimate is not None
        return (
            f"within the tolerances with a probability of {verdict.probability:.0%} by the estimate, whose "
            f"error is up to {1000 * estimate.error_95_m:.0f} mm in 95 % of drives; {self._remedies()}"
        )

    def _remedies(self) -> str:
        """Return what would make the estimate more certain, in words."""
        absent = {
            "external poses": not self.placed,
            "a gyro": not self.measurements.taken["imu"],
            "a profile of 'identify'": self.config.rover is None,
        }
        if self.placed and not self._lasting.declared:
            return NOT_DECLARED
        remedies = [remedy for remedy, missing in absent.items() if missing]
        return f"{' or '.join(remedies) or 'more or better external poses'} would reduce it"

    def _drive(self) -> None:
        """Run all ticks, and record the estimate at the end of the last."""
        first = None
        while first is None:
            first = self._take(POLL_S)
            self._check()
        self.keeper = keeper = RateKeeper(self._period_ns, first.ref.measured_ns)
        newest = first
        while True:
            now_ns = self._clock.monotonic_ns()
            if now_ns >= keeper.deadline_ns:
                keeper.skip_missed(now_ns, self.config.ticks)
            fresh = newest.ref.measured_ns >= keeper.opens_ns
            if fresh or now_ns >= keeper.deadline_ns:
                last = keeper.index >= self.config.ticks or self.mission.over
                self._tick(newest, now_ns, predicted=not fresh, last=last)
                if last:
                    return
            newest = self._take((keeper.deadline_ns - self._clock.monotonic_ns()) / NS_PER_S) or newest
            if not self.mission.over:  # nothing takes back what is decided
                self._check()

    def _tick(self, newest: Measurement[OdometrySample], now_ns: int, predicted: bool, last: bool) -> None:
        mission, t = self.mission, self._start.seconds_to(now_ns)
        index = self.config.ticks if last and not mission.over else self.keeper.index
        evidence = None if last else self._evidence(now_ns)
        tick = None if last else mission.tick(index, t, evidence)
        estimate = self.estimate = tick.estimate if tick else mission.record_estimate(index, t)
        sequence = None
        if tick is not None and not self.config.dry_run:
            self.monitor.check_command(tick.command, estimate.velocity)
            self._check_poses(estimate.velocity, now_ns)
            if self._touched and not mission.over:
                try:
                    self._request_motors()
                except UnreachableError as error:  # the drive has begun, so it ends as one
                    raise SafetyStop("lease", str(error)) from error
            if not (self._touched and mission.over):
                sequence = self._link.command(tick.command)
        if not predicted:
            self.latencies_ns.append(self._clock.monotonic_ns() - newest.arrival_ns)
        record = TickRecord(
            index=index,
            now_ns=now_ns,
            wall_ns=self._clock.time_ns(),
            samples=tuple(self._used),
            predicted=predicted,
            estimate=numbers(estimate),
            command=tick.command if tick else None,
            sequence=sequence,
            evidence=evidence,
        )
        self._publisher.tick(record, estimate, tick)
        self._used.clear()
        self._touched = False
        if not last:
            self.keeper.ticked(now_ns, predicted)
        self._publish_status()

    def _request_motors(self) -> None:
        place, undock = self.config.place, self.config.undock
        docking = f"{'undocking from ' if undock else DOCKING}{place.name}" if place else ""
        self._link.request_motors(docking or f"policy {self.config.policy}")
        self.monitor.granted()

    def _take(self, timeout_s: float) -> Measurement[OdometrySample] | None:
        """Give new measurements to the estimator; return the odometry, if it came in time."""
        odometry = self.measurements.odometry(min(max(timeout_s, 0.0), POLL_S))
        # A gyro reading is published before the odometry of its cycle.
        measured: list[Measurement[Any]] = [*self.measurements.gyro(), *([odometry] if odometry else [])]
        poses = self.measurements.poses()
        if self.placed:
            measured += sorted(poses, key=lambda pose: pose.ref.measured_ns)
        self._apply(measured)
        return odometry

    def _apply(self, measured: Sequence[Measurement[Any]]) -> None:
        """Give measurements to the estimator, in this order."""
        for sample, ref, _ in measured:
            self.mission.take(sample, self._start.seconds_to(ref.measured_ns))
            self._used.append(ref)

    def _check(self) -> None:
        """Raise SafetyStop if a safety rule is broken, KeyboardInterrupt after a termination signal."""
        try:
            self.monitor.check()
        except SafetyStop as stop:
            # The gate has stopped the rover. A docking decides in its next tick what that contact was.
            other_end = self.monitor.bumped(1 - self.mission.leading_end)
            if stop.rule not in CONTACTS or not self.mission.on_contact(other_end=other_end):
                raise
            self._touched = True
        estimator = self.mission.estimator
        if estimator.fault:
            raise SafetyStop(estimator.fault_rule, estimator.fault)

    def _evidence(self, now_ns: int) -> Evidence | None:
        """Return what the base reports beside its motion, for a mission that needs a proof."""
        proof, charge = self.mission.proof, self._link.charge
        if proof is None:
            return None
        # What is pressed when the lease is granted does not end it.
        pressed = self.estimate is None and self._link.bumpers.pressed[self.mission.leading_end]
        found = self._link.docked if proof is Proof.TOPIC else (charge.at(now_ns), charge.reports)
        return Evidence(self._touched or pressed, *found)

    def _check_poses(self, velocity: Velocity, now_ns: int) -> None:
        """Raise SafetyStop if external poses are required and none is used while the rover moves."""
        used, config = self.mission.estimator.poses[Acceptance.ACCEPTED], self.config
        stands = abs(velocity.v) < STANDING.v and abs(velocity.omega) < STANDING.omega
        if used != self._poses_used:
            self._poses_used, self._blind_ns = used, 0
        elif not stands:
            self._blind_ns += now_ns - (self._looked_ns or now_ns)
        self._looked_ns = now_ns
        if config.pose == "required" and self._blind_ns > config.pose_age_s * NS_PER_S:
            words = f"the rover has moved for {config.pose_age_s:g} s without an external pose that fits"
            raise SafetyStop("pose-age", words)

    def _enter(self, phase: Phase, reason: str = "") -> None:
        self.phase, self.reason = phase, reason
        self._publish_status()

    def _publish_status(self) -> None:
        keeper = self.keeper
        stage = self.mission.words if self.phase is Phase.DRIVING else ""
        self._publisher.status(
            DriverStatus(
                state=stage or self.phase.value,
                drive=self._id,
                reason=self.reason,
                policy=self.config.policy,
                course=self.config.course,
                tick=keeper.index,
                t_s=keeper.index * TICK_S,
                overruns=keeper.overruns,
                error_95_m=None if self.estimate is None else self.estimate.error_95_m,
                probability=None if self.verdict is None else self.verdict.probability,
            )
        )
