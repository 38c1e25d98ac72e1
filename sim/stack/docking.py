"""Trials of docking through the whole stack, judged by the true pose.

The robots are those of `trials`. Each starts somewhere before the place, and a camera of its own sees tags
there. The world's frame is that of the place.
"""

import copy
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np

from deploy.drive.config import DriveConfig, place_config
from deploy.place.docking import Docking
from deploy.place.outcome import DockError, DockResult, PoseErrors
from deploy.place.place import Place
from deploy.place.plan import approach
from rover_ncp.circuit.policy import Policy
from rover_ncp.core.errors import UsageError
from rover_ncp.core.files import DEFAULT_ROBOT
from rover_ncp.core.geometry import Pose, compose
from rover_ncp.core.streams import Domain, integer_seed, random_stream
from rover_ncp.course.feasibility import clearance_at
from rover_ncp.robot.description import RobotDescription, load_description
from rover_ncp.robot.profile import RoverProfile
from sim.base.trial import BaseTrial, draw_rover
from sim.stack.lines import simulated_base
from sim.stack.tag_camera import TagLocaliser, camera_direction
from sim.stack.trials import drive_whole, localiser_errors, new_drive, with_estimator
from sim.stack.virtual import VirtualBridge, VirtualLink
from sim.world.randomization import Randomization

DISTANCES_M = 0.5, 2.5
BEARING_RAD = math.radians(60.0)
"""Starts: this far from the place, at bearings up to this off its axis."""
HEADING_RAD = math.radians(30.0)
"""Largest turn of a start from the direction in which the tags are."""
MAX_DRAWS = 1000
"""Maximum number of draws until a start is clear of obstacles and has tags in its image."""


class Docked(NamedTuple):
    """How a trial ended."""

    result: DockResult
    stop: str
    """The safety rule that stopped the drive, or ""."""
    off: PoseErrors
    """Of the true pose."""
    docked: bool
    """Whether the true pose is within the place's tolerances."""
    seconds: float

    @property
    def error_m(self) -> float:
        """The distance from the place."""
        return math.hypot(self.off.longitudinal_m, self.off.lateral_m)

    @property
    def error_rad(self) -> float:
        """The turn from the place's heading."""
        return abs(self.off.yaw_rad)

    @property
    def reason(self) -> str:
        """Why the trial is no success; "" if the driver says docked and the true pose agrees."""
        if self.stop:
            return f"stopped by {self.stop}"
        if self.result.success:
            return "" if self.docked else "falsely docked"
        return DockError(self.result.error_code).name


@dataclass(frozen=True)
class DockTrials:
    """Settings of the trials; ``staging`` drives to the staging pose and ``dock`` into the place."""

    staging: Policy
    dock: Policy
    place: Place
    ranges: Randomization
    seed: int
    gyro: bool = True
    robot: RobotDescription | None = None
    localiser: type[TagLocaliser] = TagLocaliser
    estimator: Mapping[str, float] = field(default_factory=dict)
    """Estimator settings that replace the driver's."""
    blind: bool = False
    """Whether the rovers start with no tag in the image, at any heading."""

    @cached_property
    def description(self) -> RobotDescription:
        """The description of the simulated robot."""
        return self.robot or load_description(DEFAULT_ROBOT)

    @cached_property
    def _docking(self) -> Docking:
        return Docking(self._config, self.staging, self.dock)

    @cached_property
    def _config(self) -> DriveConfig:
        known = RoverProfile(
            name=f"a robot of {self.ranges.name}",
            noise_m=self.ranges.noise_m,
            noise_rad=self.ranges.noise_rad,
        )
        place, sight = self.localiser.taught(self.place), self.localiser.sight(self.place)
        name = self.dock.circuit.name
        config = place_config(place, known, self.robot, robot="virtual", policy=name, sight=sight)
        return with_estimator(config, self.estimator)

    def start(self, number: int) -> Pose:
        """Return where the robot of a trial starts: clear of obstacles, with tags in its image or with none.

        Raises UsageError if the obstacles leave no such start.
        """
        stream = random_stream(self.seed, Domain.DOCKING, number)
        for _ in range(MAX_DRAWS):
            start = self._drawn(stream)
            clear = clearance_at(start, self.place.obstacles, self.description) > 0.0
            sees = self.localiser.has_none if self.blind else self.localiser.has_tags
            if clear and sees(start, self.place):
                return start
        raise UsageError(f"place '{self.place.name}': its obstacles leave no start before it")

    def _drawn(self, stream: np.random.Generator) -> Pose:
        away = stream.uniform(*DISTANCES_M)
        bearing, heading = stream.uniform(-1.0, 1.0, 2) * (
            BEARING_RAD,
            math.pi if self.blind else HEADING_RAD,
        )
        direction = camera_direction(self.place)
        x, y = -away * math.cos(bearing), -away * math.sin(bearing)
        from_place = Pose(x, y, math.atan2(-y, self.localiser.tags_ahead_m - x) + heading)
        # Turned about the place for a rover that backs in, its tail towards the place.
        return compose(self.place.goal, compose(compose(direction, from_place), direction))

    def drive(self, number: int) -> Docked:
        """Drive a trial from power-up to the motors' release."""
        course, start = approach(self.place).course, self.start(number)
        rover, trials = draw_rover(
            self.ranges, self.description, course, seed=self.seed, number=number, start=start
        )
        base_seed = integer_seed(self.seed, Domain.BASE_SENSORS, number)
        base = simulated_base(self.description, rover, BaseTrial(trials), gyro=self.gyro, seed=base_seed)
        bridge = VirtualBridge(base)
        link = VirtualLink(bridge, None)
        stream = random_stream(self.seed, Domain.CAMERA, number)
        errors = localiser_errors(self.ranges, self.seed, number)
        camera = self.localiser(rover, self.place, stream, link.localise, errors)
        base.observe = camera.observe
        link.declare(camera.lasting_error)
        docking = copy.deepcopy(self._docking)
        drive = new_drive(link, docking, self.dock.circuit.neurons, self._config)
        drive_whole(drive)
        stop = "" if drive.stop is None else drive.stop.rule
        off, docked = self.place.errors(rover.pose), self.place.holds(rover.pose)
        return Docked(docking.result(drive.reason), stop, off, docked, bridge.monotonic())
