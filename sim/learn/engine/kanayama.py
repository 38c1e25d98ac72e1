"""The tracking law of Kanayama et al. (1990), with the observation and the limits of the circuits.

Its inputs are the pose and the velocity of the reference relative to the rover. Below two thresholds the
output is zero, because the inputs are noisy and a parked rover has to stand still. The search of the circuit
tuned the three gains and the thresholds on the circuit's trials and cost (``benchmarks/compare.py``).
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rover_ncp.course.reference import COMMAND_MAX
from rover_ncp.kernels.jit import kernel
from sim.learn.engine.lane_runner import LaneRunner

FloatArray = NDArray[np.float64]

KANAYAMA = "kanayama"
TUNED = (0.4592, 16.54, 18.83, 0.007335, 0.1451)
"""k_x, k_y, k_theta, still_v and still_omega that ``benchmarks/compare.py`` found (SI units)."""


@kernel
def law_command(gains: FloatArray, observation: FloatArray) -> tuple[float, float]:
    """Return v in m/s and omega in rad/s for the reference: ahead, left, heading, speed, turn (eq. 8)."""
    ahead, left, heading = observation[0], observation[1], observation[2]
    speed, turn = observation[3], observation[4]
    v = speed * math.cos(heading) + gains[0] * ahead
    return v, turn + speed * (gains[1] * left + gains[2] * math.sin(heading))


class LawLanes(NamedTuple):
    """The arrays of L rovers that the law drives."""

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
    """Command all rovers; below its thresholds, the last two gains, the law commands zero."""
    for lane in range(len(lanes.gains)):
        gains = lanes.gains[lane]
        wanted = law_command(gains, observations[:, lane])
        for axis in range(2):
            still = abs(wanted[axis]) < gains[3 + axis]
            part = min(max(wanted[axis], -lanes.limits[axis]), lanes.limits[axis])
            commands[axis, lane] = 0.0 if still else part


def law_lane_runner() -> LaneRunner:
    """Return the runner of the law, with the limits of a circuit's commands. Its vectors are the gains."""
    limits = np.array(COMMAND_MAX)

    def allocate(count: int) -> LawLanes:
        return LawLanes(limits, np.zeros((count, len(TUNED))))

    return LaneRunner(len(TUNED), allocate, start_law, tick_laws)
