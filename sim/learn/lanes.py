"""Arrays of the native library's episodes: courses, lanes, and the queue of episodes."""

from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rover_ncp.native.core import Axes

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
    """Courses, of up to ``ticks`` ticks, up to ``still`` of them to be still."""

    ticks: Annotated[IntArray, Axes("courses", below="ticks+1")]
    still: Annotated[IntArray, Axes("courses")]
    hold: Annotated[IntArray, Axes("courses")]
    """The first tick in which a rover may hold."""
    near: Annotated[FloatArray, Axes("courses", 2)]
    """Position in m and heading in rad within which it may."""
    signal: Annotated[FloatArray, Axes("courses", "ticks+1")]
    """Start signal at the start of each tick."""
    due: Annotated[IntArray, Axes("courses", "ticks", below="checkpoints", lowest=-1)]
    """Checkpoint judged at the end of each tick, or -1."""
    checkpoints: Annotated[FloatArray, Axes("courses", "checkpoints", 3)]
    """Poses, the last one the goal."""
    goal: Annotated[FloatArray, Axes("courses", 3)]
    has_reference: bool
    reference: Annotated[FloatArray, Axes("courses", "ticks+1", 5)]
    """x, y, theta, v, omega at the start of each tick; 0 where no policy asks for it."""
    limits: Annotated[FloatArray, Axes(4)]
    """The model's accel, decel, alpha, alpha_decel."""


class Lanes(NamedTuple):
    """L lanes at work, beside the circuits and the fleet."""

    observations: Annotated[FloatArray, Axes("inputs", "lanes")]
    commands: Annotated[FloatArray, Axes(2, "lanes")]
    poses: Annotated[FloatArray, Axes(3, "lanes")]
    held: Annotated[FloatArray, Axes(2, "lanes")]
    driven: Annotated[FloatArray, Axes(2, "lanes")]
    """The command that arrived last, and the motion that the base makes of it."""
    pulses: Annotated[FloatArray, Axes(2, 3, "lanes")]
    """The driver's ``Pulse`` of v and of omega."""
    near_goal: Annotated[BoolArray, Axes("lanes")]
    holds: Annotated[BoolArray, Axes("lanes")]
    """Whether the observed pose is near the goal, and whether the rover holds."""
    odometry: Annotated[FloatArray, Axes(3, "lanes")]
    earlier: Annotated[FloatArray, Axes(3, "lanes")]
    """The pose by odometry, heading not wrapped, now and a tick ago."""
    episode: Annotated[IntArray, Axes("lanes", below="episodes", lowest=IDLE)]
    task: Annotated[IntArray, Axes("lanes", below="courses")]
    trial: Annotated[IntArray, Axes("lanes", below="trials")]
    """Of its episode."""
    tick: Annotated[IntArray, Axes("lanes", below="ticks+1", lowest=WARMING_UP)]
    total: Annotated[FloatArray, Axes("lanes")]
    """Running return."""
    tail: Annotated[FloatArray, Axes("lanes", "poses_kept", 3)]
    """Ring of the last poses, one more than the ticks to be still."""
    latest: Annotated[IntArray, Axes("lanes", below="poses_kept")]
    """Where the last of them is."""
    tracking: Annotated[FloatArray, Axes(2, "lanes")]
    """Running sums."""
    before: Annotated[IntArray, Axes("lanes")]
    """Work: the lanes' episodes before a tick."""


class Waiting(NamedTuple):
    """The episodes of a queue in groups of equal size, group by group."""

    episodes: Annotated[IntArray, Axes("episodes", below="episodes")]
    """Ring of episodes that wait for a lane."""
    ring: Annotated[IntArray, Axes(2, below="episodes+1")]
    """Where the ring begins, and how many wait."""
    left: Annotated[IntArray, Axes("groups")]
    """Episodes of each group that have not ended."""


class Queue(NamedTuple):
    """Episodes and their results."""

    vectors: Annotated[FloatArray, Axes("vectors", "parameters")]
    vector: Annotated[IntArray, Axes("episodes", below="vectors")]
    task: Annotated[IntArray, Axes("episodes", below="courses")]
    trial: Annotated[IntArray, Axes("episodes", below="trials")]
    stop_below: Annotated[FloatArray, Axes("episodes")]
    """An episode is truncated as soon as its running return is below."""
    results: Annotated[FloatArray, Axes("episodes", RESULTS)]
    residuals: Annotated[FloatArray, Axes("episodes", "checkpoints", 3)]
    """x, y and heading from each checkpoint when it was judged; 0 where none was."""
    waiting: Waiting
