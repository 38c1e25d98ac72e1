"""Classical tracking laws on the very trials, observations and limits of the circuits.

Each law sees what the course-relative circuit sees: where the reference is, from the rover, and how it
moves. Each has gains, and two thresholds below which it asks for nothing, as stillness is judged and what it
sees is noisy. Gains are tuned by the same search, on the same cost, as the circuit (``compare.py``).

kanayama        Kanayama et al. (1990), eq. 8: feed-forward plus errors along, across and in heading
pure-pursuit    Coulter (1992): the arc to a point ahead of the reference, on its tangent
smooth          Park and Kuipers (2011), eq. 14: the law of Nav2's docking, to a pose ahead of the reference
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rover_ncp.circuit.policy import course_policy
from rover_ncp.circuit.tap_withdrawal import tap_withdrawal_circuit
from rover_ncp.course.course import Course
from rover_ncp.course.reference import Reference
from rover_ncp.kernels.jit import kernel
from sim.learn.episode import IDLE, Lanes, Queue, Tasks, drive_tick, start_episode
from sim.learn.evaluator import Evaluator
from sim.learn.search.unit_box import UnitBox
from sim.world.fleet import Fleet, FleetArrays, wrapped
from sim.world.randomization import Trials

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

KANAYAMA, PURE_PURSUIT, SMOOTH = range(3)


class Law(NamedTuple):
    """A law, the names of its gains, and the gains that a tuning found (SI units)."""

    number: int
    gains: tuple[str, ...]
    start: tuple[float, ...]
    tuned: tuple[float, ...]


LAWS = {
    "kanayama": Law(
        KANAYAMA,
        ("k_x", "k_y", "k_theta", "still_v", "still_omega"),
        (1.0, 20.0, 8.0, 0.01, 0.03),
        (0.4592, 16.54, 18.83, 0.007335, 0.1451),
    ),
    "pure-pursuit": Law(
        PURE_PURSUIT,
        ("k_x", "ahead", "feed_forward", "still_v", "still_omega"),
        (1.0, 0.2, 0.5, 0.01, 0.03),
        (0.5704, 0.2251, 0.7081, 0.07644, 0.01963),
    ),
    "smooth": Law(
        SMOOTH,
        ("k_x", "ahead", "k_1", "k_2", "still_v", "still_omega"),
        (1.0, 0.2, 1.0, 3.0, 0.01, 0.03),
        (0.4814, 0.918, 1.185, 21.07, 0.08025, 0.01981),
    ),
}

_LEAST_AHEAD_M = 0.02
"""Least distance to the carrot for which its direction is used."""


@kernel
def law_command(law: int, gains: FloatArray, seen: FloatArray) -> tuple[float, float]:
    """Return v in m/s and omega in rad/s for what is seen: ahead, left, heading, speed, turn."""
    ahead, left, heading, speed, turn = seen[0], seen[1], seen[2], seen[3], seen[4]
    v = speed * math.cos(heading) + gains[0] * ahead
    if law == KANAYAMA:
        return v, turn + speed * (gains[1] * left + gains[2] * math.sin(heading))
    # What follows leads to a point ahead, by driving forward.
    v = max(v, 0.0)
    x, y = ahead + gains[1] * math.cos(heading), left + gains[1] * math.sin(heading)
    distance = max(math.hypot(x, y), _LEAST_AHEAD_M)
    if law == PURE_PURSUIT:
        return v, gains[2] * turn + v * 2.0 * y / distance**2
    # Both angles are measured from the line of sight: the rover's heading, and the carrot's.
    sight = math.atan2(y, x)
    delta, theta = -sight, wrapped(heading - sight)
    bent = gains[2] * theta
    wanted = math.atan(-bent)
    kappa = (
        -(gains[3] * (delta - wanted) + (1.0 + gains[2] / (1.0 + bent * bent)) * math.sin(delta)) / distance
    )
    return v, v * kappa


@kernel
def law_lanes(law: int, limits: FloatArray, lanes: Lanes, queue: Queue) -> None:
    """Command all rovers; below its thresholds, the last two gains, a law asks for nothing."""
    for lane in range(len(lanes.episode)):
        if lanes.episode[lane] == IDLE:
            continue
        gains = queue.vectors[queue.vector[lanes.episode[lane]]]
        asked = law_command(law, gains, lanes.observations[:, lane])
        for axis in range(2):
            still = abs(asked[axis]) < gains[len(gains) - 2 + axis]
            part = min(max(asked[axis], -limits[axis]), limits[axis])
            lanes.commands[axis, lane] = 0.0 if still else part


@kernel
def run_law(  # noqa: PLR0917  # as run_episodes
    law: int,
    limits: FloatArray,
    signal_at: IntArray,
    tasks: Tasks,
    trials: Trials,
    lanes: Lanes,
    fleet: FleetArrays,
    queue: Queue,
) -> None:
    """Run all episodes in the queue, as ``run_episodes`` does with circuits."""
    waiting, running = 0, 0
    lanes.episode[:] = IDLE
    while True:
        for lane in range(len(lanes.episode)):
            if lanes.episode[lane] == IDLE and waiting < len(queue.results):
                lanes.episode[lane] = waiting
                start_episode(signal_at, tasks, trials, lanes, fleet, queue, lane)
                waiting += 1
                running += 1
        if running == 0:
            return
        law_lanes(law, limits, lanes, queue)
        running -= drive_tick(signal_at, tasks, trials, lanes, fleet, queue)


class LawEngine(Evaluator):
    """An engine whose vectors are a law's gains."""

    def __init__(
        self,
        law: str,
        courses: Sequence[Course],
        trials: Trials,
        references: Sequence[Reference] | None = None,
    ) -> None:
        # Of the policy, its signals and limits count; its circuit is not run.
        policy = course_policy(tap_withdrawal_circuit())
        super().__init__(policy, courses, trials=trials, references=references)
        self._law = LAWS[law].number

    def run_queue(self, lanes: Lanes, fleet: Fleet, queue: Queue) -> None:
        """Run the episodes of a queue."""
        limits = np.array(self.policy.motors.limits)
        run_law(self._law, limits, self._signal_at, self._tasks, self._trials, lanes, fleet.arrays, queue)


def gain_box(law: Law) -> UnitBox:
    """Return the search space of a tuning: a tenth to ten times the gains that it starts from."""
    first = np.array(law.start)
    return UnitBox(0.1 * first, 10.0 * first, first, np.ones(len(first), np.bool_))
