"""A course as it is driven, tick by tick: from the estimated pose to the command. No I/O, no clock.

Rules of this file:

1. The same inputs give the same bits: `replay` runs a recording through this very class.
2. The circuit sees the signals that its sensing names (`circuit/rover_interface.py`) and nothing else. They
   come from the estimate, predicted to the moment of the tick, and from the course.
3. Before the first tick the circuit makes one tick on the start pose with the start signal at 0, its motors
   ignored, as it did in the simulator.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from deploy.drive.config import DriveConfig
from deploy.drive.measurements import Sample
from deploy.estimator.estimator import Estimate, Estimator
from deploy.estimator.settings import TURN_GAINS, EstimatorSettings
from deploy.place.outcome import Evidence
from deploy.place.room import Room
from rover_ncp.circuit.own_policy import FunctionRunner
from rover_ncp.circuit.policy import Policy
from rover_ncp.circuit.rover_interface import RoverInterface
from rover_ncp.circuit.runner import Runner
from rover_ncp.core.errors import SafetyStop
from rover_ncp.core.geometry import ORIGIN, STANDSTILL, Pose, Velocity, compose, near, wrap_angle
from rover_ncp.course.course import TICK_S, Course
from rover_ncp.course.hold import HOLD, hold_from_s, holds
from rover_ncp.course.reference import Reference, plan_reference
from rover_ncp.course.scoring import Verdict, judge
from rover_ncp.robot.dead_zone import DeadZone
from rover_ncp.robot.description import RobotDescription
from rover_ncp.robot.lasting_error import UNDECLARED, LastingError
from rover_ncp.robot.profile import RoverProfile


@dataclass(frozen=True)
class Tick:
    """Input and output of one tick: ``t`` is the course's time in s, ``potentials`` are in mV."""

    index: int
    t: float
    estimate: Estimate
    command: Velocity
    potentials: NDArray[np.float64]


class Controller:
    """Estimator and circuit of one drive. Times are seconds on one clock, any zero.

    Commands are divided by the known gains of a ``rover`` and by the turn gain that the estimator finds on
    the way, so that it moves as the circuit asks. Commands that the motors would not follow become pulses,
    if their dead band is known of the ``rover`` or ``described``. With a ``runner``, the names of its signals
    take the place of the policy. A ``reference`` takes the place of the one that is planned for the course.
    """

    def __init__(
        self,
        policy: Policy | Sequence[str],
        course: Course,
        settings: EstimatorSettings,
        rover: RoverProfile | None = None,
        described: RobotDescription | None = None,
        *,
        runner: Runner | FunctionRunner | None = None,
        reference: Reference | None = None,
    ) -> None:
        self._interface = RoverInterface(policy)
        self._course = course
        self._hold_from_s = hold_from_s(course)
        self._holds = False
        if reference is None and self._interface.needs_reference:
            reference = plan_reference(course)
        self._reference = reference
        if runner is None:
            assert isinstance(policy, Policy)  # signals come with a runner
            runner = Runner(policy)
        self._runner = runner
        self._rests = False
        self._last_moving = course.ticks
        if self._reference is not None:
            self._last_moving = int(np.flatnonzero(self._reference.motion.any(axis=1)).max(initial=0))
        self._runner.tick([0.0] * len(self._interface.places))  # a first tick takes longer than others
        self.estimator = Estimator(settings)
        self._gains = _gains(rover)
        self._dead_zone = DeadZone(rover, described)
        least = self._dead_zone.least
        self._hold = Velocity(max(HOLD.v, least.v), max(HOLD.omega, least.omega))
        self._times: list[float] = []
        self._estimates: list[Estimate] = []

    def start(
        self,
        odometry: Pose,
        t: float,
        pose: Pose = ORIGIN,
        covariance: NDArray[np.float64] | None = None,
        lasting: LastingError = UNDECLARED,
    ) -> None:
        """Begin at rest at time ``t``, at ``pose`` in the course, where odometry stands at ``odometry``.

        ``covariance`` (3, 3) is that of the pose; without one the pose defines where the course lies.
        ``lasting`` is the lasting error of the external poses.
        """
        self.estimator.start(pose, t, odometry, covariance, lasting)
        self.begin(pose)

    def begin(self, pose: Pose) -> None:
        """Begin the course at ``pose``, anew after an earlier drive; the estimator goes on."""
        self._times, self._estimates, self._holds, self._rests = [], [], False, False
        self._runner.reset()
        self._runner.tick(self._observation(pose, 0, 0.0))

    def tick(self, index: int, t: float) -> Tick:
        """Run tick ``index`` of the course at time ``t``."""
        estimate = self.record_estimate(index, t)
        start = self._course.start_signal(index * TICK_S)
        v, omega = self._runner.tick(self._observation(self._steered(estimate), index, start))
        turn_gain = float(np.clip(estimate.turn_gain, *TURN_GAINS))
        command = Velocity(float(v) / self._gains.v, float(omega) / (self._gains.omega * turn_gain))
        self._rests = self._rests or (index > self._last_moving and _slower(command, HOLD))
        if index * TICK_S > self._hold_from_s:
            self._holds = holds(*command, self._hold, self._is_parked(estimate.pose), self._holds)
            command = STANDSTILL if self._holds else command
        sent = self._dead_zone.pass_on(command)
        return Tick(index, index * TICK_S, estimate, sent, self._runner.potentials)

    def _steered(self, estimate: Estimate) -> Pose:
        """Return the pose of the centre of rotation, which does not slide, shifted to meet the goal.

        Once the rover has come to rest at the end, the lateral error is hidden: no turn on the spot reduces
        it, and a circuit rests where lateral and heading error balance.
        """
        (x, y, theta), goal, behind = estimate.pose, self._course.goal, estimate.rotation_center_m
        cos, sin = math.cos(goal.theta), math.sin(goal.theta)
        x, y = x + behind * (cos - math.cos(theta)), y + behind * (sin - math.sin(theta))
        if self._rests:
            left = (y - goal.y) * cos - (x - goal.x) * sin
            x, y = x + left * sin, y - left * cos
        return Pose(x, y, theta)

    def _is_parked(self, pose: Pose) -> bool:
        rule = self._course.parked
        return near(pose, self._course.goal, rule.position_m, rule.heading_rad)

    def record_estimate(self, index: int, t: float) -> Estimate:
        """Record the estimate at time ``t`` for the verdict, without a tick of the circuit."""
        estimate = self.estimator.at(t)
        self._times.append(index * TICK_S)
        self._estimates.append(estimate)
        return estimate

    @property
    def estimate(self) -> Estimate:
        """The newest estimate of `record_estimate`."""
        return self._estimates[-1]

    @property
    def potentials(self) -> NDArray[np.float64]:
        """The potentials of the newest tick, in mV."""
        return self._runner.potentials

    def verdict(self, goal: NDArray[np.float64] | None = None) -> Verdict:
        """Judge the drive so far on the estimate: the last pose with its covariance, and the motion before.

        ``goal`` (3, 3) is the covariance of the goal, which is exact without it.
        Earlier poses follow from the motion alone, because external poses also move the estimate of a rover
        that stands. Contact is not judged here.
        """
        if not self._estimates:
            return judge(self._course, [], [], touched=False)
        last = self._estimates[-1]
        path = [last.pose]
        for before, after in pairwise(reversed(self._estimates)):
            v, omega = 0.5 * (np.array(before.velocity) + after.velocity) * (after.t - before.t)
            path.append(compose(path[-1], Pose(v, 0.0, omega)))
        covariance = last.covariance[:3, :3] + (0.0 if goal is None else goal)
        return judge(self._course, self._times, path[::-1], False, covariance)

    def _observation(self, pose: Pose, index: int, start: float) -> list[float]:
        reference = self._reference.tick(index) if self._reference else None
        return self._interface.observe(pose, start, reference)


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
        *,
        room: Room | None = None,
    ) -> None:
        """Begin as `Controller.start`. A course is not planned by the room."""
        self._controller.start(odometry, t, pose, covariance, lasting)

    def take(self, sample: Sample, t: float) -> None:
        """Give the estimator a sample."""
        self.estimator.take(sample, t)

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


def _slower(command: Velocity, limit: Velocity) -> bool:
    return abs(command.v) < limit.v and abs(command.omega) < limit.omega


def _gains(rover: RoverProfile | None) -> Velocity:
    """Return a robot's known gains: true speed over commanded speed, and odometry's turn over commanded turn.

    The estimate has the true turn over odometry's, which begins at the profile's.
    """
    if rover is None:
        return Velocity(1.0, 1.0)
    return Velocity((rover.gain_v or 1.0) / (rover.odometry_distance or 1.0), rover.gain_omega or 1.0)
