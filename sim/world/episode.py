"""One episode of a rover on a course, tick by tick: the definition, in plain Python.

In each control tick a policy observes the pose at its start and commands v and omega, ten physics substeps
follow, and at its end the checkpoint that is due is judged. In a trial (``randomization.py``) the policy
observes what odometry believes, the command may get lost, and the base makes of it what it can. A base with a
dead band gets pulses, as from a driver that knows the band. Where the observation errs, the rover holds at
the end of the course, as the driver's does. The native library gives the same bits.
"""

from rover_ncp.core.geometry import Pose, Velocity, near, wrap_angle
from rover_ncp.course.course import TICK_S, Course
from rover_ncp.course.hold import HOLD, hold_from_s, holds
from rover_ncp.course.scoring import due_checkpoints, reward
from rover_ncp.robot.dead_zone import STEP, Pulse, clear_of, pulsed
from sim.world.motion_errors import (
    apply_base_errors,
    base_errors,
    dead_reckon,
    odometry_errors,
    push_tick,
    quantise,
)
from sim.world.pymunk_rover import Ground, PymunkRover, require_free_start
from sim.world.randomization import Trials, nominal_trials, trial_model
from sim.world.rover import SUBSTEPS, RoverModel


class Odometry:
    """A rover's observation of its own pose in a trial."""

    def __init__(self, trials: Trials, row: int) -> None:
        self._trials, self._row = trials, row
        self._errors = odometry_errors(trials, row)
        self._sees_pose = trials.exact or trials.sensors[1]
        self._now = self._earlier = self._true = Pose(*trials.start[row].tolist())

    def moved(self, pose: Pose) -> None:
        """Take in where a tick brought the rover."""
        self._earlier = self._now
        self._now = pose if self._sees_pose else dead_reckon(self._now, self._true, pose, self._errors)
        self._true = pose

    def pushed(self, pose: Pose) -> None:
        """Take in a push, which no wheel measures: the next tick begins from where it brought the rover."""
        self._true = pose
        if self._sees_pose:
            self._now = pose

    def seen(self, tick: int) -> Pose:
        """Return the pose shown at the start of a tick."""
        if self._trials.exact:
            return self._now
        age = float(self._trials.age[self._row, tick])
        noise = self._trials.noise[self._row, tick].tolist()
        x, y, theta = (
            now + (error - age * (now - earlier))
            for now, earlier, error in zip(self._now, self._earlier, noise, strict=True)
        )
        return Pose(x, y, wrap_angle(theta))


class Episode:
    """A rover at the start of a course, as the model is or in trial ``row``.

    Raises ConfigError for a start that is blocked.
    """

    def __init__(self, course: Course, model: RoverModel, trials: Trials | None = None, row: int = 0) -> None:
        require_free_start(model, course)
        self.course = course
        trials = self._trials = trials or nominal_trials(model, course.ticks)
        self._row, self._due = row, due_checkpoints(course)
        self.rover = PymunkRover(
            trial_model(model, trials, row), Ground(course.obstacles), Pose(*trials.start[row].tolist())
        )
        self.tick = 0
        self.touched = False
        self._odometry = Odometry(trials, row)
        self._base = base = base_errors(trials, row)
        self._least = clear_of(base.dead_band_v, STEP.v), clear_of(base.dead_band_omega, STEP.omega)
        self._hold = Velocity(max(HOLD.v, self._least[0]), max(HOLD.omega, self._least[1]))
        self._held = self._driven = 0.0, 0.0
        self._pulses = Pulse(), Pulse()
        self._stays = False
        self._pushed_at = push_tick(float(trials.bump[row, 0]), course.ticks)

    @property
    def seen(self) -> Pose:
        """The pose that a policy observes now."""
        return self._odometry.seen(self.tick)

    @property
    def over(self) -> bool:
        """Whether the course's horizon is reached."""
        return self.tick >= self.course.ticks

    def step(self, v: float, omega: float) -> float:
        """Command v in m/s and omega in rad/s for a tick; return the reward at its end."""
        trials, row, rover = self._trials, self._row, self.rover
        if not trials.exact and TICK_S * self.tick > hold_from_s(self.course):
            rule = self.course.parked
            parked = near(self.seen, self.course.goal, rule.position_m, rule.heading_rad)
            self._stays = holds(v, omega, self._hold, parked, self._stays)
        wanted = (0.0, 0.0) if self._stays else (v, omega)
        self._pulses = (
            pulsed(wanted[0], self._least[0], self._pulses[0]),
            pulsed(wanted[1], self._least[1], self._pulses[1]),
        )
        if not trials.lost[row, self.tick]:
            self._held = (
                quantise(self._pulses[0].sent, float(trials.step[0])),
                quantise(self._pulses[1].sent, float(trials.step[1])),
            )
        self._driven = apply_base_errors(*self._held, self._base, self._driven)
        rover.command(*self._driven)
        for _ in range(SUBSTEPS):
            rover.substep()
            self.touched = self.touched or rover.in_contact
        checkpoint, gain = self._due[self.tick], 0.0
        if checkpoint >= 0:
            gain = reward(rover.pose, self.course.checkpoints[checkpoint].pose)
        self._odometry.moved(rover.pose)
        self.tick += 1
        if self.tick == self._pushed_at and not trials.exact:
            rover.push(Pose(*trials.bump[row, 1:].tolist()))
            self._odometry.pushed(rover.pose)
        return gain
