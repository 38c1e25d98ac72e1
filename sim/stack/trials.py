"""Random trials through the whole stack: firmware, bridge and driver as they are, on a virtual clock.

The trials are those of `evaluate`, drawn from the same seeds. Here their errors act where a robot has them,
at the base. The driver is that of `deploy`. Beside its packets and its start pose it knows the description
and the profile of its robot, and a profile that names the noise of its odometry. The true pose is judged.
"""

import copy
import math
from bisect import bisect_right
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import as_completed
from dataclasses import dataclass, field
from functools import cached_property, partial
from typing import NamedTuple, TypeVar

from deploy.drive.config import DriveConfig, config_for
from deploy.drive.control_loop import Drive
from deploy.drive.controller import Controller, CourseMission
from deploy.drive.measurements import Measurements
from deploy.drive.mission import Mission
from deploy.drive.safety_monitor import SafetyMonitor
from deploy.identify.excitation import FENCE_M, excite
from deploy.identify.fit import identify
from deploy.identify.motion_log import motion_log
from rover_ncp.core.files import DEFAULT_ROBOT
from rover_ncp.core.geometry import Pose
from rover_ncp.core.streams import Domain, integer_seed, random_stream
from rover_ncp.course.course import Course
from rover_ncp.course.scoring import Verdict, judge
from rover_ncp.recording.recording import Recorded
from rover_ncp.robot.description import RobotDescription, load_description
from rover_ncp.robot.profile import RoverProfile
from sim.base.trial import BaseTrial, Drawn, draw_rover
from sim.learn.policies import AnyPolicy
from sim.learn.workers import ProcessPool, available_processes, made_in_each_process
from sim.stack.camera import CeilingCamera
from sim.stack.estimates import Belief, belief_of
from sim.stack.lines import simulated_base
from sim.stack.virtual import TicklessPublisher, VirtualBridge, VirtualLink
from sim.world.described import described_rover
from sim.world.localiser_errors import LocaliserErrors
from sim.world.randomization import Randomization
from sim.world.rover import Rover, RoverModel

FoundT = TypeVar("FoundT")
ANYWHERE_M = 1000.0
_WORTH_A_PROCESS = 6
"""Fewer trials take no longer than a process takes to start."""


class Driven(NamedTuple):
    """How a trial ended, by the true pose."""

    parked: bool
    reason: str
    """A `Failure`, or the safety rule that stopped the drive; "" if it parked."""
    error_m: float
    error_rad: float
    pose: Pose
    ticks: int
    overruns: int
    belief: Belief


@dataclass(frozen=True)
class Stack:
    """Settings of the trials: trial i of a seed on course i modulo their number."""

    policy: AnyPolicy
    courses: tuple[Course, ...]
    ranges: Randomization
    seed: int
    gyro: bool = False
    """Whether the base has a gyro for its driver."""
    camera: bool = False
    """Whether there is external localisation while the rover drives."""
    identify: bool = False
    """Whether each robot is identified before its drive, on its ground, under the camera."""
    robot: RobotDescription | None = None
    """The model of robot; None is a Pioneer 3-AT without a description for its driver."""
    estimator: Mapping[str, float] = field(default_factory=dict)
    """Estimator settings that replace the driver's."""

    @cached_property
    def description(self) -> RobotDescription:
        """The description of the simulated robot."""
        return self.robot or load_description(DEFAULT_ROBOT)

    @cached_property
    def model(self) -> RoverModel:
        """The nominal rover."""
        return described_rover(self.description)

    @cached_property
    def known(self) -> RoverProfile:
        """The driver's robot profile: the given one, if any, with the noise of odometry."""
        return self._with_noise(self.ranges.rover or RoverProfile(name=f"a robot of {self.ranges.name}"))

    @property
    def varies(self) -> bool:
        """Whether the trials of a course differ: in their robots, or in the noise of a sensor."""
        odometry = self.description.odometry
        noises = odometry.noise_m, odometry.noise_rad, odometry.noise_m_s, odometry.noise_rad_s
        noisy = self.description.arcos is None and any(noises)  # a mock Pioneer's encoders have no noise
        return self.ranges.varies or self.gyro or self.camera or self.identify or noisy

    def _with_noise(self, rover: RoverProfile) -> RoverProfile:
        noises = {"noise_m": self.ranges.noise_m, "noise_rad": self.ranges.noise_rad}
        unknown = {name: noise for name, noise in noises.items() if getattr(rover, name) is None}
        return rover.model_copy(update=unknown)

    @cached_property
    def _controllers(self) -> dict[int, Controller]:
        """Controllers by course; a reference takes a second to plan."""
        return {}

    def course(self, number: int) -> Course:
        """Return the course of a trial."""
        return self.courses[number % len(self.courses)]

    def drawn(self, number: int) -> Drawn:
        """Return the robot of a trial."""
        return draw_rover(self.ranges, self.description, self.course(number), seed=self.seed, number=number)

    def identified(self, number: int) -> RoverProfile:
        """Identify the robot of a trial as `rover-ncp identify` does; return the driver's profile."""
        robot, seed = self.description, self.seed
        rover, trials = draw_rover(self.ranges, robot, None, seed=seed, number=number)
        base = simulated_base(robot, rover, BaseTrial(trials), gyro=False)
        bridge, received = VirtualBridge(base), list[Recorded]()
        link = VirtualLink(bridge, rover.pose, received.append)
        stream = random_stream(seed, Domain.IDENTIFICATION, number)
        errors = localiser_errors(self.ranges, seed, number)
        camera = CeilingCamera(rover, stream, link.localise, errors)
        base.observe = camera.observe
        link.declare(camera.lasting_error)
        measurements = Measurements(link)
        monitor = SafetyMonitor(link, measurements, lambda: False, clock=bridge)
        monitor.wait()
        bands = excite(link, measurements, monitor, FENCE_M, bridge)
        return self._with_noise(identify(motion_log(received, robot, link.lasting_error), robot.name, bands))

    def drive(self, number: int) -> Driven:
        """Drive a trial from power-up to the motors' release."""
        known = self.identified(number) if self.identify else self.known
        course, (rover, trials) = self.course(number), self.drawn(number)
        base_seed = integer_seed(self.seed, Domain.BASE_SENSORS, number)
        base = simulated_base(self.description, rover, BaseTrial(trials), gyro=self.gyro, seed=base_seed)
        bridge = VirtualBridge(base)
        link = VirtualLink(bridge, rover.pose)
        truth = _Truth(rover, watch=bool(course.obstacles))
        watching = [truth.note]
        if self.camera:
            stream = random_stream(self.seed, Domain.CAMERA, number)
            errors = localiser_errors(self.ranges, self.seed, number)
            camera = CeilingCamera(rover, stream, link.localise, errors)
            watching.append(camera.observe)
            link.declare(camera.lasting_error)

        def observe(now: float) -> None:
            for watch in watching:
                watch(now)

        base.observe = observe
        config = config_for(
            course,
            known,
            self.robot,
            robot=link.robot,
            policy=self.policy.name,
            # Rates are measured from any start of the randomization.
            start_m=ANYWHERE_M,
            start_rad=math.pi,
        )
        config = with_estimator(config, self.estimator)
        mission = CourseMission(self._controller(number, config), config)
        drive = new_drive(link, mission, self.policy.neurons, config)
        drive_whole(drive)
        report = drive.keeper.report()
        verdict = truth.judge(course, link.first_command_ns)
        return Driven(
            verdict.parked and drive.stop is None,
            verdict.failure if drive.stop is None else f"stopped by {drive.stop.rule}",
            verdict.error_m,
            verdict.error_rad,
            rover.pose,
            report.ticks,
            report.overruns,
            belief_of(drive, rover.pose),
        )

    def _controller(self, number: int, config: DriveConfig) -> Controller:
        """Return a driver that has not started yet."""
        place = number % len(self.courses)
        if self.identify or place not in self._controllers:
            runner = self.policy.runner()
            self._controllers[place] = Controller(
                self.policy.signals,
                self.courses[place],
                config.estimator,
                config.rover,
                config.described,
                runner=runner,
            )
        return copy.deepcopy(self._controllers[place])


def with_estimator(config: DriveConfig, changes: Mapping[str, float]) -> DriveConfig:
    """Return the settings of a drive with some of the estimator's replaced."""
    return config.model_copy(update={"estimator": config.estimator.model_copy(update=dict(changes))})


def localiser_errors(ranges: Randomization, seed: int, number: int) -> LocaliserErrors | None:
    """Return the errors of a trial's external poses; None if they are those of the camera alone."""
    if ranges.localiser is None:
        return None
    return LocaliserErrors(ranges.localiser, random_stream(seed, Domain.LOCALISER, number))


class _Truth:
    """True poses of the rover at every substep."""

    def __init__(self, rover: Rover, watch: bool) -> None:
        self._rover, self._watch = rover, watch
        self._times: list[float] = []
        self._poses: list[Pose] = []
        self._touched = False

    def note(self, now: float) -> None:
        """Note the true pose at ``now`` s."""
        self._times.append(now)
        self._poses.append(self._rover.pose)
        self._touched = self._touched or (self._watch and self._rover.in_contact)

    def judge(self, course: Course, began_ns: int | None) -> Verdict:
        """Judge the drive from its first command to the course's horizon."""
        began = self._times[-1] if began_ns is None else began_ns * 1e-9
        first, last = (bisect_right(self._times, began + t) for t in (-1e-6, course.horizon_s + 1e-6))
        times = [now - began for now in self._times[first:last]]
        return judge(course, times, self._poses[first:last], self._touched)


def new_drive(link: VirtualLink, mission: Mission, neurons: Sequence[str], config: DriveConfig) -> Drive:
    """Return a drive on the virtual clock, without subscribers and without a recording."""
    bridge = link.bridge
    publisher = TicklessPublisher(link, lambda message: None, neurons, bridge)
    return Drive(link, mission, publisher, config, lambda: False, clock=bridge)


def drive_whole(drive: Drive) -> None:
    """Drive until the end. Raises NoPose, and KeyboardInterrupt, which a driver takes for its own end."""
    drive.wait()
    drive.run()
    if drive.verdict is None and drive.stop is None:
        raise KeyboardInterrupt


def drive_all(
    drive: Callable[[int], FoundT],
    count: int,
    processes: int | None,
    on_done: Callable[[], None] = lambda: None,
) -> list[FoundT]:
    """Drive trials 0 to ``count`` − 1 by their numbers; ``on_done`` is called after each. Raises WorkerDied.

    ``processes`` is by default as many as there are cores and work for.
    """
    found: dict[int, FoundT] = {}
    for number, trial in drive_each(drive, range(count), processes):
        found[number] = trial
        on_done()
    return [found[number] for number in range(count)]


def drive_each(
    drive: Callable[[int], FoundT], numbers: Sequence[int], processes: int | None
) -> Iterator[tuple[int, FoundT]]:
    """Drive trials by their numbers; yield number and end of each as it ends. Raises WorkerDied."""
    workers = processes or min(available_processes(), max(len(numbers) // _WORTH_A_PROCESS, 1))
    if workers == 1:
        for number in numbers:
            yield number, drive(number)
        return
    made = made_in_each_process(partial(_same, drive))
    with ProcessPool(workers) as pool:
        waiting = {pool.submit(made, number): number for number in numbers}
        for done in as_completed(waiting):
            yield waiting[done], done.result()


def _same(drive: Callable[[int], FoundT]) -> Callable[[int], FoundT]:
    """Return the function: each process unpickles its trials once, with what they keep."""
    return drive
