"""Observation and action spaces of the two Gymnasium environments: the simulator's and the robot's."""

from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np

from rover_ncp.core.errors import ConfigError
from rover_ncp.course.reference import SIGNALS

FARTHEST_M = 1000.0

_RANGES = {
    "x": (-FARTHEST_M, FARTHEST_M),
    "y": (-FARTHEST_M, FARTHEST_M),
    "theta": (-np.pi, np.pi),
    "start": (0.0, 1.0),
}
"""Least and greatest value of a signal; the others have no bounds."""

ACTIONS: Any = gymnasium.spaces.Box(np.array([-0.16, -0.18]), np.array([0.16, 0.18]), dtype=np.float64)
"""v in m/s and omega in rad/s: the paper's motors."""


def observation_space(signals: Sequence[str] = ("x", "y", "theta", "start")) -> Any:
    """Return the space of the named signals (n,), in m, rad, m/s and rad/s. Raises ConfigError."""
    if unknown := [name for name in signals if name not in SIGNALS]:
        words = f"unknown signals {', '.join(unknown)}; known are {', '.join(SIGNALS)}"
        raise ConfigError("observation", [words])
    low, high = zip(*(_RANGES.get(name, (-np.inf, np.inf)) for name in signals), strict=True)
    return gymnasium.spaces.Box(np.array(low), np.array(high), dtype=np.float64)
