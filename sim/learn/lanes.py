"""Arrays of the episode kernel: courses, lanes, and the queue of episodes."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rover_ncp.kernels.vectors import RowArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

IDLE = -1
WARMING_UP = -1

RESULTS = 8
"""Numbers an episode ends in, in this order: return; distance (m) and angle (rad) to the goal; the farthest
that pose and heading were, in the time to be still, from where they ended (m, rad); touched (0 or 1); means
over all ticks of the squared distance (m²) and angle (rad²) to the reference."""


class Tasks(NamedTuple):
    """C courses as the kernel sees them; up to T ticks, up to W ticks to be still."""

    ticks: IntArray
    still: IntArray
    """(C,) each."""
    hold: IntArray
    """(C,) the first tick in which a rover may hold."""
    near: FloatArray
    """(C, 2) position in m and heading in rad within which it may."""
    signal: FloatArray
    """(C, T + 1) start signal at the start of each tick."""
    due: IntArray
    """(C, T) checkpoint judged at the end of each tick, or -1."""
    checkpoints: FloatArray
    """(C, checkpoints, 3) poses, the last one the goal."""
    goal: FloatArray
    """(C, 3)."""
    has_reference: bool
    reference: FloatArray
    """(C, T + 1, 5): x, y, theta, v, omega at the start of each tick; 0 where no policy asks for it."""
    limits: FloatArray
    """(4,) the model's accel, decel, alpha, alpha_decel."""


class Lanes(NamedTuple):
    """L lanes at work, beside the runner's own arrays and the fleet."""

    observations: FloatArray
    commands: FloatArray
    poses: FloatArray
    """(inputs, L), (2, L), (3, L)."""
    held: FloatArray
    driven: FloatArray
    """(2, L) each: the command that arrived last, and the motion that the base makes of it."""
    pulses: FloatArray
    """(2, 3, L) the driver's ``Pulse`` of v and of omega."""
    near_goal: BoolArray
    holds: BoolArray
    """(L,) each: whether the observed pose is near the goal, and whether the rover holds."""
    odometry: FloatArray
    earlier: FloatArray
    """(3, L) each: the pose by odometry, heading not wrapped, now and a tick ago."""
    episode: IntArray
    """(L,) or IDLE."""
    task: RowArray
    trial: RowArray
    """(L,) of its episode."""
    tick: IntArray
    """(L,) or WARMING_UP."""
    total: FloatArray
    """(L,) running return."""
    tail: FloatArray
    """(L, W + 1, 3) ring of the last poses."""
    latest: RowArray
    """(L,) where the last of them is."""
    tracking: FloatArray
    """(2, L) running sums."""
    signals: FloatArray
    """(signals,) work: all signals that a controller may observe."""
    before: IntArray
    """(L,) work: the lanes' episodes before a tick."""


class Waiting(NamedTuple):
    """The E episodes of a queue in G groups of equal size, group by group."""

    episodes: IntArray
    """(E,) ring of episodes that wait for a lane."""
    ring: IntArray
    """(2,) where the ring begins, and how many wait."""
    left: IntArray
    """(G,) episodes of each group that have not ended."""


class Queue(NamedTuple):
    """E episodes and their results."""

    vectors: FloatArray
    """(V, P)."""
    vector: IntArray
    task: IntArray
    trial: IntArray
    """(E,) each: rows of vectors, tasks and trials."""
    stop_below: FloatArray
    """(E,) an episode is truncated as soon as its running return is below."""
    results: FloatArray
    """(E, RESULTS)."""
    residuals: FloatArray
    """(E, checkpoints, 3) x, y and heading from each checkpoint when it was judged; 0 where none was."""
    waiting: Waiting
