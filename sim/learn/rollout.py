"""One policy driving one rover through a course, the plain way, with all that there is to see of it.

An episode begins with every neuron at rest and one warm-up tick of the circuit on the start observation
without the start signal, its motors ignored, as in the paper's simulator. ``sim/world/episode.py`` defines
the rest. ``evaluator.py`` does the same for many candidates at once and gives the same bits.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rover_ncp.circuit.own_policy import FunctionRunner
from rover_ncp.circuit.policy import Policy
from rover_ncp.circuit.rover_interface import RoverInterface
from rover_ncp.circuit.runner import Runner
from rover_ncp.course.course import TICK_S, Course
from rover_ncp.course.reference import Reference, plan_reference
from rover_ncp.course.scoring import Verdict, judge
from sim.world.described import default_rover
from sim.world.episode import Episode
from sim.world.randomization import Trials
from sim.world.rover import RoverModel

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
    verdict: Verdict


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
    if reference is None and interface.needs_reference:
        reference = plan_reference(course)
    episode = Episode(course, model, trials, row)
    if runner is None:
        assert isinstance(policy, Policy)  # signals come with a runner
        runner = Runner(policy)
    runner.reset()

    def observation(signal: float) -> list[float]:
        motion = reference.tick(episode.tick) if reference else None
        return interface.observe(episode.seen, signal, motion)

    runner.tick(observation(0.0))
    poses, seen, commands, potentials, total = [episode.rover.pose], [], [], [], 0.0
    while not episode.over:
        seen.append(episode.seen)
        v, omega = runner.tick(observation(course.start_signal(TICK_S * episode.tick)))
        total += episode.step(v, omega)
        poses.append(episode.rover.pose)
        commands.append((v, omega))
        potentials.append(runner.potentials)
    times = [TICK_S * tick for tick in range(course.ticks + 1)]
    return Rollout(
        times=np.array(times),
        poses=np.array(poses),
        seen=np.array(seen),
        commands=np.array(commands),
        potentials=np.array(potentials),
        touched=episode.touched,
        total=total,
        verdict=judge(course, times, poses, episode.touched),
    )
