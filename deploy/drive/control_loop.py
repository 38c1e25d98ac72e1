"""The drive itself: its states in their order, the loop of ticks, and the reasons for its end.

Rules of this file:

1. At every end of a drive, the lease is released before anything else.
2. Odometry sets off the tick; when it does not come in time, the tick runs on prediction and is counted.
3. Before each command, a tick checks the bridge, the age of odometry, the estimator, the lease and the
   rover's response. If a check fails, the drive ends with the rule's name.
"""

import math
import time
from collections.abc import Callable

import numpy as np

from deploy.drive.clock import NS, RateKeeper
from deploy.drive.config import DriveConfig
from deploy.drive.controller import ORIGIN, Controller
from deploy.drive.link import Link
from deploy.drive.measurements import GyroIntake, Intake, PoseIntake, Sample, SeenPose, StillWatch, middle
from deploy.drive.phases import Event, State, next_state
from deploy.drive.response import ResponseWatch
from deploy.drive.safety_monitor import Guard, Interrupted
from deploy.drive.status_publisher import Reporter
from deploy.drive_records import SampleRef, StartRecord, TickRecord, numbers, seconds
from deploy.estimator.settings import Outcome
from rover_ncp.core.errors import AnotherDriver, NoPose, SafetyStop
from rover_ncp.core.process import Clock
from rover_ncp.core.protocol import DriverStatus
from rover_ncp.course.course import TICK_S, Verdict

POLL_S = 0.02


class Drive:
    """One drive over an open link. ``run`` returns when it is over; the attributes hold the result.

    ``period_s`` is how long a tick lasts by the clock; a benchmark lets the course's time run faster.
    """

    def __init__(
        self,
        link: Link,
        controller: Controller,
        reporter: Reporter,
        config: DriveConfig,
        interrupted: Callable[[], bool],
        *,
        clock: Clock = time,
        period_s: float = TICK_S,
    ) -> None:
        self._period_ns = round(period_s * NS)
        self._link, self._controller, self._reporter = link, controller, reporter
        self._config, self._clock = config, clock
        self._pending: list[SampleRef] = []
        self._response = ResponseWatch()
        self.intake = Intake(link.odometry)
        self._guard = Guard(link, self.intake, config, interrupted, clock)
        self.poses = PoseIntake(link.poses)
        self._gyro = GyroIntake(link.gyro)
        self._standing_poses: list[SeenPose] = []
        self._placed = False
        self.keeper = RateKeeper(self._period_ns, 0)
        self.state = State.WAITING
        self.reason = ""
        self.stop: SafetyStop | None = None
        self.verdict: Verdict | None = None
        self.latencies_ns: list[int] = []
        """From the arrival of odometry to its command on the wire."""

    @property
    def rejected(self) -> int:
        """Odometry samples that the estimator refused."""
        return self._controller.estimator.rejected

    def pose_counts(self) -> dict[str, int]:
        """Return whether external poses placed the rover, and the outcomes of all poses."""
        became = self._controller.estimator.poses
        return {
            "placed": self._placed,
            "taken": self.poses.count,
            "unreadable": self.poses.garbled,
            "used": became[Outcome.ACCEPTED],
            "refused": became[Outcome.OUTLIER] + became[Outcome.NOT_FINITE],
            "too_late": became[Outcome.TOO_OLD],
        }

    @property
    def progress(self) -> str:
        """One line for people; may be asked for by another thread."""
        keeper, newest = self.keeper, self.intake.newest
        where = "odometry x {:.3f} y {:.3f} θ {:.3f}".format(*newest.pose) if newest else ""
        return f"{self.state.value}  t {keeper.index * TICK_S:.1f} s  {where}  overruns {keeper.overruns}"

    def wait(self) -> None:
        """Wait for bridge, permission and odometry.

        Raises NoBridge, NotAuthorised, NoRobot or Interrupted.
        """
        self._guard.wait(not self._config.dry_run, self._config.namespace)

    def run(self, attachments: dict[str, int]) -> None:
        """Drive, after `wait`. ``attachments`` are the checksums of the recording's files.

        Raises AnotherDriver, NotAuthorised and NoBridge when the motors are refused; ``state``, ``reason``
        and ``stop`` hold the reason for a later end.
        """
        try:
            try:
                self._arm(attachments)
                self._drive()
            finally:
                self._link.release()
        except SafetyStop as stop:
            self.stop = stop
            self._follow(Event.FAULT, str(stop))
        except Interrupted:
            self._follow(Event.INTERRUPTED, "interrupted")
        else:
            self.verdict = self._controller.verdict()
            event = Event.PARKED if self.verdict.parked else Event.NOT_PARKED
            self._follow(event, self.verdict.reason)
        self._reporter.finish()

    def _arm(self, attachments: dict[str, int]) -> None:
        config = self._config
        watch = StillWatch(config.still_s, config.still_m, config.still_rad)
        if not self._guard.until(lambda: self._stands(watch), config.still_wait_s):
            raise SafetyStop("not-standing", f"the rover does not stand still for {config.still_s:g} s")
        if config.pose == "required" and not self._guard.until(
            lambda: self._stands(watch) and bool(self._standing_poses), config.pose_wait_s
        ):
            raise NoPose(f"no external pose of the rover arrived on 'pose' within {config.pose_wait_s:g} s")
        sample = self.intake.newest
        assert sample is not None  # it stands, so it was seen
        self._follow(Event.READY)
        pose, covariance = ORIGIN, None
        if self._standing_poses:
            self._placed = True
            pose = middle([seen.pose for seen in self._standing_poses])
            # The covariance of the last one: errors of these poses are not independent.
            covariance = self._standing_poses[-1].covariance
        self._controller.start(sample.pose, 0.0, pose, covariance)
        self._start = sample.ref
        record = StartRecord(
            sample=sample.ref,
            pose=pose,
            covariance=None if covariance is None else tuple(covariance.ravel().tolist()),
            attachments=attachments,
        )
        self._reporter.start(record, sample.pose)
        if not config.dry_run:
            self._link.request_motors(f"policy {config.policy}")
            self._guard.granted()
        self._follow(Event.GRANTED)

    def _drive(self) -> None:
        """Run all ticks, and look once more at the end of the last."""
        first = None
        while first is None:
            first = self._take(POLL_S)
            self._check()
        self.keeper = keeper = RateKeeper(self._period_ns, first.ref.measured_ns)
        newest = first
        while True:
            now_ns = self._clock.monotonic_ns()
            if now_ns >= keeper.deadline_ns:
                keeper.skip_missed(now_ns, self._config.ticks)
            fresh = newest.ref.measured_ns >= keeper.opens_ns
            if fresh or now_ns >= keeper.deadline_ns:
                last = keeper.index >= self._config.ticks
                self._tick(newest, now_ns, predicted=not fresh, last=last)
                if last:
                    return
            newest = self._take((keeper.deadline_ns - self._clock.monotonic_ns()) / NS) or newest
            self._check()

    def _tick(self, newest: Sample, now_ns: int, predicted: bool, last: bool) -> None:
        controller, t = self._controller, seconds(now_ns, self._start)
        index = self._config.ticks if last else self.keeper.index
        tick = None if last else controller.tick(index, t)
        estimate = tick.estimate if tick else controller.look(index, t)
        sequence = None
        if tick is not None and not self._config.dry_run:
            if not all(map(math.isfinite, tick.command)):
                raise SafetyStop("command", f"the circuit asks for {tick.command}")
            if unfollowed := self._response.tick(tick.command, estimate.velocity):
                held = f" (the gate says: {self._link.gate.held})" if self._link.gate.held else ""
                raise SafetyStop("no-response", f"the rover drove {unfollowed}{held}")
            sequence = self._link.command(tick.command)
        if not predicted:
            self.latencies_ns.append(self._clock.monotonic_ns() - newest.arrival_ns)
        wall_ns = self._clock.time_ns()
        self._reporter.tick(
            TickRecord(
                index=index,
                now_ns=now_ns,
                wall_ns=wall_ns,
                samples=tuple(self._pending),
                predicted=predicted,
                estimate=numbers(estimate),
                command=tick.command if tick else None,
                sequence=sequence,
            ),
            estimate,
            tick,
        )
        self._pending.clear()
        if not last:
            self.keeper.ticked(now_ns, predicted)
        self._tell_status()

    def _take(self, timeout_s: float) -> Sample | None:
        """Take odometry, if it comes in time, into the estimator."""
        sample = self.intake.take(min(max(timeout_s, 0.0), POLL_S))
        for turn in self._gyro.take():  # comes before the odometry of its cycle
            self._controller.gyro(turn.rate, seconds(turn.ref.measured_ns, self._start))
            self._pending.append(turn.ref)
        if sample is not None:
            self._controller.odometry(
                sample.pose, sample.velocity, seconds(sample.ref.measured_ns, self._start)
            )
            self._pending.append(sample.ref)
        for seen in sorted(self.poses.take(), key=lambda seen: seen.ref.measured_ns):
            if self._placed:
                t = seconds(seen.ref.measured_ns, self._start)
                self._controller.external(seen.pose, seen.covariance, t)
                self._pending.append(seen.ref)
        return sample

    def _check(self) -> None:
        """Raise SafetyStop if a safety rule is broken, Interrupted if a termination signal was received."""
        self._guard.check()
        estimator = self._controller.estimator
        if estimator.fault:
            raise SafetyStop(estimator.fault_rule, estimator.fault)

    def _stands(self, watch: StillWatch) -> bool:
        gate = self._link.gate
        if gate.lease and not self._config.dry_run:
            # A rover that another driver drives does not stand still until that driver releases the lease.
            who = gate.driver_name or "a driver without a name"
            raise AnotherDriver(f"the bridge at {self._link.robot} refuses the motors: {who} holds the lease")
        self._hear_poses()
        sample = self.intake.take(0)
        return sample is not None and watch.see(sample)

    def _hear_poses(self) -> None:
        """Keep the external poses that say where the rover stands now."""
        if self._config.pose == "none":
            return
        oldest = self._clock.monotonic_ns() - self._config.still_s * NS
        heard = [*self._standing_poses, *self.poses.take()]
        self._standing_poses = [
            seen
            for seen in heard
            if seen.ref.measured_ns >= oldest and np.isfinite([*seen.pose, *seen.covariance.ravel()]).all()
        ]

    def _follow(self, event: Event, reason: str = "") -> None:
        self.state, self.reason = next_state(self.state, event), reason
        self._tell_status()

    def _tell_status(self) -> None:
        keeper = self.keeper
        self._reporter.status(
            DriverStatus(
                state=self.state.value,
                reason=self.reason,
                policy=self._config.policy,
                course=self._config.course,
                tick=keeper.index,
                t_s=keeper.index * TICK_S,
                overruns=keeper.overruns,
            )
        )
