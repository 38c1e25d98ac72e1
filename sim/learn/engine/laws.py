"""Classical tracking laws on the very trials, observations and limits of the circuits.

Each law sees what the course-relative circuit sees: where the reference is, from the rover, and how it
moves. Each has gains, and two thresholds below which it asks for nothing, as stillness is judged and what it
sees is noisy. Gains are tuned by the same search, on the same cost, as the circuit (``compare.py``).

kanayama        Kanayama et al. (1990), eq. 8: feed-forward plus errors along, across and in heading
pure-pursuit    Coulter (1992): the arc to a point ahead of the reference, on its tangent
smooth          Park and Kuipers (2011), eq. 14: the law of Nav2's docking, to a pose ahead of the reference
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rover_ncp.course.reference import COMMAND_MAX
from rover_ncp.kernels.jit import kernel
from sim.learn.engine.lane_runner import LaneRunner
from sim.world.fleet import wrapped

FloatArray = NDArray[np.float64]

KANAYAMA, PURE_PURSUIT, SMOOTH = range(3)


class Law(NamedTuple):
    """A law, the names of its gains, and the gains that ``benchmarks/compare.py`` found (SI units)."""

    number: int
    gains: tuple[str, ...]
    tuned: tuple[float, ...]


LAWS = {
    "kanayama": Law(
        KANAYAMA,
        ("k_x", "k_y", "k_theta", "still_v", "still_omega"),
        (0.4592, 16.54, 18.83, 0.007335, 0.1451),
    ),
    "pure-pursuit": Law(
        PURE_PURSUIT,
        ("k_x", "ahead", "feed_forward", "still_v", "still_omega"),
        (0.5704, 0.2251, 0.7081, 0.07644, 0.01963),
    ),
    "smooth": Law(
        SMOOTH,
        ("k_x", "ahead", "k_1", "k_2", "still_v", "still_omega"),
        (0.4814, 0.918, 1.185, 21.07, 0.08025, 0.01981),
    ),
}

_MIN_AHEAD_M = 0.02
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
    distance = max(math.hypot(x, y), _MIN_AHEAD_M)
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


class LawLanes(NamedTuple):
    """The arrays of L rovers that a law drives."""

    law: int
    limits: FloatArray
    """(2,) of v and omega."""
    gains: FloatArray
    """(L, G)."""


@kernel
def start_law(lanes: LawLanes, lane: int, vector: FloatArray) -> None:
    """Set a lane's gains (G,)."""
    lanes.gains[lane] = vector


@kernel
def tick_laws(lanes: LawLanes, observations: FloatArray, commands: FloatArray) -> None:
    """Command all rovers; below its thresholds, the last two gains, a law commands zero."""
    for lane in range(len(lanes.gains)):
        gains = lanes.gains[lane]
        asked = law_command(lanes.law, gains, observations[:, lane])
        for axis in range(2):
            still = abs(asked[axis]) < gains[len(gains) - 2 + axis]
            part = min(max(asked[axis], -lanes.limits[axis]), lanes.limits[axis])
            commands[axis, lane] = 0.0 if still else part


def law_lane_runner(law: Law) -> LaneRunner:
    """Return the runner of a law, with the limits of a circuit's commands. Its vectors are the gains."""
    limits = np.array(COMMAND_MAX)

    def allocate(count: int) -> LawLanes:
        return LawLanes(law.number, limits, np.zeros((count, len(law.gains))))

    return LaneRunner(len(law.gains), allocate, start_law, tick_laws)
