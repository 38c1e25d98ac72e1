"""The dead band of a robot's motors: the least command that it follows, from a record of its motion."""

import math

import numpy as np

from deploy.identify.excitation import LEVEL_S, RAMP, follows
from deploy.identify.motion_log import FloatArray, MotionLog

SETTLED_S = 0.2
"""Time at the end of a constant command in which motion is judged."""


def dead_bands(log: MotionLog) -> tuple[float | None, float | None]:
    """Return the least speed command and the least turn command that the robot follows.

    0 for a robot that follows the slowest step of a ramp; None without a ramp, or if the robot follows a
    command but not a faster one.
    """
    return _dead_band(log, 0, RAMP.v), _dead_band(log, 1, RAMP.omega)


def _dead_band(log: MotionLog, axis: int, step: float) -> float | None:
    levels = _levels(log, axis)
    least = min((size for size, followed in levels if followed), default=math.inf)
    most = max((size for size, followed in levels if not followed), default=0.0)
    if not 0.0 < least - most <= 1.01 * step:
        return None
    return least if most else 0.0


def _levels(log: MotionLog, axis: int) -> list[tuple[float, bool]]:
    """Return each lasting command on this axis alone, and whether the robot followed it."""
    changes = np.flatnonzero(np.abs(np.diff(log.sent, axis=0)).max(axis=1) > 0.0) + 1
    starts = np.concatenate([[0], changes])
    ends_s: FloatArray = np.append(log.sent_s[changes], log.odometry.t[-1])
    found = []
    for start, end_s in zip(starts.tolist(), ends_s.tolist(), strict=True):
        command = log.sent[start]
        if command[axis] == 0.0 or command[1 - axis] != 0.0 or end_s - log.sent_s[start] < LEVEL_S - 0.1:
            continue
        late = (log.odometry.t > end_s - SETTLED_S) & (log.odometry.t <= end_s)
        if late.any():
            followed = follows(float(log.motion[late, axis].mean()), float(command[axis]))
            found.append((abs(float(command[axis])), followed))
    return found
