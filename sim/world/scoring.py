"""The paper's reward: minus the squared miss of each checkpoint, 1 rad counting as 1 m.

Which checkpoint is judged when depends on the course alone: at the end of each control tick the next one
whose deadline has come, at most one a tick. Headings differ by the shorter way round.
"""

import numpy as np
from numpy.typing import NDArray

from rover_ncp.core.course import TICK_S, Course
from rover_ncp.core.geometry import Pose, wrap_angle


def due_checkpoints(course: Course) -> NDArray[np.int64]:
    """Return (ticks,): the index of the checkpoint judged at the end of each tick, or -1.

    Tick k ends at 0.1 (k + 1) s; the tolerance keeps a deadline at a tick's end there whatever its last bit.
    """
    due = np.full(course.ticks, -1, np.int64)
    following = 0
    for tick in range(course.ticks):
        end_s = TICK_S * (tick + 1)
        if following < len(course.checkpoints) and course.checkpoints[following].t <= end_s + 1e-9:
            due[tick] = following
            following += 1
    return due


def reward(pose: Pose, checkpoint: Pose) -> float:
    """Return the reward for being at ``pose`` at the deadline of ``checkpoint``: 0 at best."""
    dx, dy = pose.x - checkpoint.x, pose.y - checkpoint.y
    dtheta = wrap_angle(pose.theta - checkpoint.theta)
    return -(dx * dx + dy * dy + dtheta * dtheta)
