"""One policy driving one rover through a course, the plain way, with all that there is to see of it.

An episode, as the paper's simulator runs it: every neuron at rest, one warm-up tick of the circuit on the
start observation without the start signal, its motors ignored. Then in each control tick the circuit sees the
pose at its start, its command is sent, ten physics substeps follow, and at its end the checkpoint that is due
is judged. ``engine.py`` does the same for many candidates at once and gives the same bits.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rover_ncp.circuit.policy import Policy, PolicyRunner
from rover_ncp.core.course import TICK_S, Course, Verdict
from rover_ncp.core.errors import ConfigError
from rover_ncp.core.geometry import Pose, distance
from sim.world.bay import Bay
from sim.world.fleet import SUBSTEPS
from sim.world.rover import Rover, RoverModel, require_free_start
from sim.world.scoring import due_checkpoints, reward

__all__ = ["INPUTS", "OUTPUTS", "START", "Rollout", "require_driver", "rollout"]

FloatArray = NDArray[np.float64]

INPUTS = ("x", "y", "theta", "start")
OUTPUTS = ("v", "omega")
START = Pose(0.0, 0.0, 0.0)


@dataclass(frozen=True, eq=False)
class Rollout:
    """What happened in T ticks of 0.1 s; poses are true, in the course's frame (m, m, rad)."""

    times: FloatArray
    """(T + 1,) s, from 0."""
    poses: FloatArray
    """(T + 1, 3), the first one the start."""
    commands: FloatArray
    """(T, 2): v in m/s and omega in rad/s, as sent at the start of each tick."""
    potentials: FloatArray
    """(T, n) mV, after each tick."""
    touched: bool
    total: float
    """The return: the sum of all rewards."""
    rms_m: float
    """Root mean square of the distances to the checkpoints, each when it was judged."""
    verdict: Verdict


def require_driver(policy: Policy) -> None:
    """Raise ConfigError unless a policy drives a rover from its pose: parking's inputs, outputs and tick."""
    problems = [
        f"{what} must be {', '.join(expected)}, got {', '.join(found)}"
        for what, expected, found in (
            ("inputs", INPUTS, policy.sensing.inputs),
            ("outputs", OUTPUTS, policy.motors.outputs),
        )
        if expected != found
    ]
    if not math.isclose(policy.tick_s, TICK_S):
        problems.append(f"a tick (dt_s times substeps) must be {TICK_S} s, got {policy.tick_s:g} s")
    if problems:
        raise ConfigError(f"policy {policy.circuit.name}", problems)


def rollout(policy: Policy, course: Course, model: RoverModel | None = None) -> Rollout:
    """Drive a course from its start to its horizon. Raises ConfigError when the policy cannot drive."""
    require_driver(policy)
    model = model or RoverModel()
    require_free_start(model, course)
    rover, runner = Rover(model, Bay(course.obstacles), START), PolicyRunner(policy)
    runner.warm_up([*START, 0.0])
    poses, commands, potentials, misses = [rover.pose], [], [], []
    touched, total = False, 0.0
    for tick, checkpoint in enumerate(due_checkpoints(course)):
        v, omega = runner.tick([*rover.pose, course.start_signal(TICK_S * tick)])
        rover.command(v, omega)
        for _ in range(SUBSTEPS):
            rover.substep()
            touched = touched or rover.in_contact
        poses.append(rover.pose)
        commands.append((v, omega))
        potentials.append(runner.potentials)
        if checkpoint >= 0:
            target = course.checkpoints[checkpoint].pose
            total += reward(rover.pose, target)
            misses.append(distance(rover.pose, target))
    times = [TICK_S * tick for tick in range(course.ticks + 1)]
    return Rollout(
        times=np.array(times),
        poses=np.array(poses),
        commands=np.array(commands),
        potentials=np.array(potentials),
        touched=touched,
        total=total,
        rms_m=math.sqrt(sum(miss * miss for miss in misses) / len(misses)),
        verdict=course.judge(times, poses, touched),
    )
