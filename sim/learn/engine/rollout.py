"""One policy driving one rover through a course, the plain way, with all that there is to see of it.

An episode, as the paper's simulator runs it: every neuron at rest, one warm-up tick of the circuit on the
start observation without the start signal, its motors ignored. Then in each control tick the circuit sees the
pose at its start, its command is sent, ten physics substeps follow, and at its end the checkpoint that is due
is judged. In a trial (``sim/world/randomization.py``) the circuit sees what odometry believes, the command
may get lost, and the base makes of it what it can. A base with a dead band gets pulses, as from a driver that
knows the band. Where the observation errs, the rover holds at the end of the course, as the driver's does.
``evaluator.py`` does the same for many candidates at once and gives the same bits.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rover_ncp.circuit.policy import Policy
from rover_ncp.circuit.rover_interface import FunctionRunner, RoverInterface
from rover_ncp.circuit.runner import Runner
from rover_ncp.core.geometry import Pose, Velocity, distance, near, wrap_angle
from rover_ncp.course.course import TICK_S, Course
from rover_ncp.course.hold import HOLD, hold_from_s, holds
from rover_ncp.course.reference import Reference, plan_reference
from rover_ncp.course.scoring import Verdict, due_checkpoints, judge, reward
from rover_ncp.robot.dead_zone import STEP, Pulse, clear_of, pulsed
from sim.world.described import default_rover
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

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Rollout:
    """Trace of T ticks of 0.1 s; poses are true, in the course's frame (m, m, rad)."""

    times: FloatArray
    """(T + 1,) s, from 0."""
    poses: FloatArray
    """(T + 1, 3), the first one the start."""
    seen: FloatArray
    """(T, 3) what the circuit was shown at the start of each tick."""
    commands: FloatArray
    """(T, 2): v in m/s and omega in rad/s, as the policy commands them at the start of each tick."""
    potentials: FloatArray
    """(T, n) mV, after each tick."""
    touched: bool
    total: float
    """The return: the sum of all rewards."""
    rms_m: float
    """Root mean square of the distances to the checkpoints, each when it was judged."""
    verdict: Verdict


class _Odometry:
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
        """Take in a push, which no wheel sees: the next tick begins from where it brought the rover."""
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


def rollout(
    policy: Policy | Sequence[str],
    course: Course,
    model: RoverModel | None = None,
    *,
    trials: Trials | None = None,
    row: int = 0,
    reference: Reference | None = None,
    runner: Runner | FunctionRunner | None = None,
) -> Rollout:
    """Drive a course to its horizon, as the model is or in trial ``row``.

    With a ``runner``, the names of its signals take the place of the policy. Raises ConfigError when the
    policy cannot drive.
    """
    interface = RoverInterface(policy)
    model = model or default_rover()
    require_free_start(model, course)
    trials = trials or nominal_trials(model, course.ticks)
    if reference is None and interface.needs_reference:
        reference = plan_reference(course)
    start, odometry = Pose(*trials.start[row].tolist()), _Odometry(trials, row)
    rover = PymunkRover(trial_model(model, trials, row), Ground(course.obstacles), start)
    if runner is None:
        assert isinstance(policy, Policy)  # signals come with a runner
        runner = Runner(policy)
    runner.reset()

    def observation(tick: int, signal: float) -> list[float]:
        return interface.observe(odometry.seen(tick), signal, reference.tick(tick) if reference else None)

    runner.tick(observation(0, 0.0))
    base = base_errors(trials, row)
    least = clear_of(base.dead_band_v, STEP.v), clear_of(base.dead_band_omega, STEP.omega)
    held, driven, pulses, stays = (0.0, 0.0), (0.0, 0.0), (Pulse(), Pulse()), False
    hold, rule = Velocity(max(HOLD.v, least[0]), max(HOLD.omega, least[1])), course.parked
    poses, seen, commands, potentials, distances = [rover.pose], [], [], [], []
    touched, total = False, 0.0
    pushed_at = push_tick(float(trials.bump[row, 0]), course.ticks)
    for tick, checkpoint in enumerate(due_checkpoints(course)):
        seen.append(odometry.seen(tick))
        v, omega = runner.tick(observation(tick, course.start_signal(TICK_S * tick)))
        if not trials.exact and TICK_S * tick > hold_from_s(course):
            parked = near(odometry.seen(tick), course.goal, rule.position_m, rule.heading_rad)
            stays = holds(v, omega, hold, parked, stays)
        wanted = (0.0, 0.0) if stays else (v, omega)
        pulses = pulsed(wanted[0], least[0], pulses[0]), pulsed(wanted[1], least[1], pulses[1])
        if not trials.lost[row, tick]:
            held = (
                quantise(pulses[0].sent, float(trials.step[0])),
                quantise(pulses[1].sent, float(trials.step[1])),
            )
        driven = apply_base_errors(*held, base, driven)
        rover.command(*driven)
        for _ in range(SUBSTEPS):
            rover.substep()
            touched = touched or rover.in_contact
        if checkpoint >= 0:
            target = course.checkpoints[checkpoint].pose
            total += reward(rover.pose, target)
            distances.append(distance(rover.pose, target))
        odometry.moved(rover.pose)
        if tick + 1 == pushed_at and not trials.exact:
            push = Pose(*trials.bump[row, 1:].tolist())
            rover.push(push)
            odometry.pushed(rover.pose)
        poses.append(rover.pose)
        commands.append((v, omega))
        potentials.append(runner.potentials)
    times = [TICK_S * tick for tick in range(course.ticks + 1)]
    return Rollout(
        times=np.array(times),
        poses=np.array(poses),
        seen=np.array(seen),
        commands=np.array(commands),
        potentials=np.array(potentials),
        touched=touched,
        total=total,
        rms_m=math.sqrt(sum(error * error for error in distances) / len(distances)),
        verdict=judge(course, times, poses, touched),
    )
