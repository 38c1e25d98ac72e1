"""The errors of a random trial in one base: those of its wheels and of its encoders.

The simulator counts a trial in control ticks. A base has no ticks, but each of its SIPs triggers one in the
driver. So a base counts the SIPs since its motors were first enabled. The trial's noise begins with the first
of them. While the window of a lost tick is open, setpoints do not arrive. A SIP's delay is the age of the
pose in that tick. Quantised commands are not among a trial's errors here: ARCOS has its own steps.
"""

from typing import NamedTuple

import numpy as np

from rover_ncp.core.geometry import ORIGIN, Pose, Velocity
from rover_ncp.course.course import TICK_S, Course
from rover_ncp.robot.description import RobotDescription
from sim.world.described import described_rover
from sim.world.motion_errors import apply_base_errors, base_errors, odometry_errors, push_tick
from sim.world.pymunk_rover import Ground, PymunkRover
from sim.world.randomization import Randomization, Trials, draw_trials, trial_body
from sim.world.rover import SUBSTEP_S, Rover, RoverModel
from sim.world.skid_robot import draw_robot, rigid_body_of

TRIAL_TICKS = 600
"""Length of a trial without a course; its noise then begins again."""


class BaseTrial:
    """The first of ``trials``; what may change with the tick is that of tick ``tick``."""

    def __init__(self, trials: Trials) -> None:
        self._trials = trials
        self._base = base_errors(trials, 0)
        self._odometry = odometry_errors(trials._replace(sensors=(False, False)), 0)
        self.efforts = dict(
            zip(("accel", "alpha", "decel", "alpha_decel"), trials.acceleration[0].tolist(), strict=True)
        )
        """Factors on the acceleration limits that are set in the base."""
        self.tick = -1
        """Before the first; and after the last there is neither loss nor push."""

    def driven(self, v: float, omega: float, before: tuple[float, float]) -> tuple[float, float]:
        """Return the motion that a setpoint (m/s, rad/s) leads to after the motion of the one before."""
        return apply_base_errors(v, omega, self._base, before)

    def measured(self, motion: Velocity) -> Velocity:
        """Return the motion that encoders and gyro see."""
        errors = self._odometry
        v = errors.distance_scale * motion.v
        turn = motion.omega * (1.0 + errors.slip * abs(motion.omega)) - errors.wheel_mismatch * v
        return Velocity(v, errors.heading_scale * turn + errors.drift)

    @property
    def noise(self) -> Pose:
        """Offset of the pose in the SIP that begins this tick."""
        if self.tick < 0 or self._trials.exact:
            return ORIGIN
        rows = self._trials.noise[0]
        return Pose(*rows[self.tick % len(rows)].tolist())

    @property
    def next_age_s(self) -> float:
        """How late the SIP is that begins the next tick, in whole substeps."""
        ages = self._trials.age[0]
        return SUBSTEP_S * round(float(ages[(self.tick + 1) % len(ages)]) * TICK_S / SUBSTEP_S)

    @property
    def lost(self) -> bool:
        """Whether setpoints get lost."""
        lost = self._trials.lost[0]
        return 0 <= self.tick < len(lost) and bool(lost[self.tick])

    @property
    def push(self) -> Pose | None:
        """Displacement of the rover by a push at the start of this tick."""
        share, *push = self._trials.bump[0].tolist()
        due = push_tick(share, self._trials.lost.shape[1])
        return Pose(*push) if self.tick == due and any(push) else None


def rover_of(trials: Trials, model: RoverModel, ground: Ground) -> PymunkRover:
    """Return the rover of the first trial at its start; other errors are a `BaseTrial`'s."""
    return PymunkRover(trial_body(model, trials, 0), ground, Pose(*trials.start[0].tolist()))


class Drawn(NamedTuple):
    """One random robot."""

    rover: Rover
    """At its start, with its delays."""
    trials: Trials
    """Its trial, the only one."""


def draw_rover(
    ranges: Randomization,
    description: RobotDescription,
    course: Course | None,
    *,
    seed: int,
    number: int,
    start: Pose | None = None,
) -> Drawn:
    """Draw trial ``number`` of a seed, for as long as the course lasts; ``start`` replaces the drawn one."""
    model = described_rover(description, motors=True)
    ticks, obstacles = (course.ticks, course.obstacles) if course else (TRIAL_TICKS, ())
    trials = draw_trials(ranges, model, seed, count=1, ticks=ticks, first=number)
    if start is not None:
        trials = trials._replace(start=np.array([start]))
    if ranges.skid_steer is None:
        return Drawn(rover_of(trials, model, Ground(obstacles)), trials)
    from sim.world.mujoco_rover import MujocoRover  # needs an extra of its own

    usual = rigid_body_of(description)
    robot, start = draw_robot(ranges.skid_steer, seed, number, usual), Pose(*trials.start[0].tolist())
    return Drawn(MujocoRover(trial_body(model, trials, 0), robot, obstacles, start), trials)
