"""Observation and action spaces of the two Gymnasium environments: the simulator's and the robot's."""

from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np

from rover_ncp.core.errors import ConfigError
from rover_ncp.course.course import FAR_M, OMEGA_MAX, V_MAX
from rover_ncp.course.signals import unknown_signals

_RANGES = {
    "x": (-FAR_M, FAR_M),
    "y": (-FAR_M, FAR_M),
    "theta": (-np.pi, np.pi),
    "start": (0.0, 1.0),
}
"""Lower and upper bound of a signal; the others have no bounds."""

_LIMITS = np.array([V_MAX, OMEGA_MAX])
ACTIONS: Any = gymnasium.spaces.Box(-_LIMITS, _LIMITS, dtype=np.float64)
"""v in m/s and omega in rad/s: the paper's motors."""


def observation_space(signals: Sequence[str] = ("x", "y", "theta", "start")) -> Any:
    """Return the space of the named signals (n,), in m, rad, m/s and rad/s. Raises ConfigError."""
    if problems := unknown_signals(signals):
        raise ConfigError("observation", problems)
    low, high = zip(*(_RANGES.get(name, (-np.inf, np.inf)) for name in signals), strict=True)
    return gymnasium.spaces.Box(np.array(low), np.array(high), dtype=np.float64)
