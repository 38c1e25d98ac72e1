"""The room that the gate's fence leaves for ways. No I/O, no clock.

The fence lies in odom, so that it counts where odometry will show the rover on a way: after a turn that
odometry measures wrongly, the rest of the way lies turned in odom.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from pydantic import Field

from rover_ncp.core.config import StrictModel
from rover_ncp.core.geometry import Pose
from rover_ncp.course.reference import FloatArray, Reference
from rover_ncp.wire.protocol import Fence

EDGE_M = 0.12
"""Room at the edges: the gate assumes that a rover goes on for up to 0.7 s at its speed."""
ROOMY_M = 0.3
"""Preferred room: a skid-steered rover moves about while it turns, and drives back to its way."""
GAIN_SHARE = 0.1
"""The turn gain may differ from the estimated one by this share, as on another floor."""


class Fit(NamedTuple):
    """How ways fit into a room."""

    risk: int
    """0 if they stay inside also with another turn gain, else 1."""
    near: bool
    """Whether they come nearer to an edge than `ROOMY_M`."""
    left: Pose | None = None
    """Where odometry leaves the room first, None if it stays inside."""


class Room(StrictModel):
    """The gate's fence at the start of a drive, and the turn gain that a turn before the start showed."""

    fence: Fence
    turn_gain: float | None = Field(default=None, gt=0, description="true turn over odometry's")

    def fit(self, references: Sequence[Reference], odometry: Pose, turn_gain: float) -> Fit:
        """Return how ways in a row fit; ``odometry`` is its pose at the begin."""
        path = _odometry_path(references, odometry, turn_gain)
        if (left := self._leaves(path, EDGE_M)) is not None:
            return Fit(1, True, left)
        others = [
            _odometry_path(references, odometry, (1.0 + share) * turn_gain)
            for share in (-GAIN_SHARE, GAIN_SHARE)
        ]
        risk = int(any(self._leaves(each, EDGE_M) is not None for each in others))
        return Fit(risk, any(self._leaves(each, ROOMY_M) is not None for each in (path, *others)))

    def _leaves(self, path: FloatArray, edge: float) -> Pose | None:
        """Return where odometry's path (n, 3) leaves the room first; a rover outside may come nearer."""
        f, (x, y) = self.fence, path[:, :2].T
        beyond = np.max([f.x_min - x, x - f.x_max, f.y_min - y, y - f.y_max], axis=0) + edge
        outside = np.flatnonzero((beyond > 0.0) & (beyond > beyond[0] + 1e-6))
        return Pose(*path[outside[0]].tolist()) if len(outside) else None

    def words(self, left: Pose) -> str:
        """Return the words for ways of which the shortest leaves the room at a pose of odometry."""
        f = self.fence
        return (
            f"every way there leaves the gate's fence (x {f.x_min:g} to {f.x_max:g} m, y {f.y_min:g} to "
            f"{f.y_max:g} m in odom, {EDGE_M:g} m kept free), the shortest at x {left.x:.2f} m, "
            f"y {left.y:.2f} m of odometry; make the fence larger, or start where the way lies inside"
        )


def _odometry_path(references: Sequence[Reference], odometry: Pose, turn_gain: float) -> FloatArray:
    """Return odometry's poses (n, 3) along ways, from its present one."""
    steps = np.concatenate([np.diff(reference.poses, axis=0) for reference in references])
    heading = np.concatenate([reference.poses[:-1, 2] for reference in references])
    turns = np.remainder(steps[:, 2] + math.pi, math.tau) - math.pi
    middle = heading + 0.5 * turns
    ahead = steps[:, 0] * np.cos(middle) + steps[:, 1] * np.sin(middle)
    theta = odometry.theta + np.concatenate([[0.0], np.cumsum(turns / turn_gain)])
    direction = 0.5 * (theta[:-1] + theta[1:])
    path: FloatArray = np.column_stack(
        [
            odometry.x + np.concatenate([[0.0], np.cumsum(ahead * np.cos(direction))]),
            odometry.y + np.concatenate([[0.0], np.cumsum(ahead * np.sin(direction))]),
            theta,
        ]
    )
    return path
