"""The connection of a policy to a rover: its signals, and its outputs v and omega."""

import math
from collections.abc import Sequence

from rover_ncp.circuit.policy import Policy
from rover_ncp.core.errors import ConfigError
from rover_ncp.core.geometry import Pose, Velocity
from rover_ncp.course.course import TICK_S
from rover_ncp.course.signals import SIGNALS, needs_reference, signals, unknown_signals

DEFAULT_SIGNALS = ("x", "y", "theta", "start")
"""Observation of a policy that names no signals."""


class RoverInterface:
    """A policy's connection to a rover. A policy that is no circuit is given by the names of its signals.

    Raises ConfigError for unknown signals and for a policy that drives no rover.
    """

    def __init__(self, policy: Policy | Sequence[str]) -> None:
        if isinstance(policy, Policy):
            source, names = f"policy {policy.circuit.name}", policy.sensing.inputs
            problems = _problems(policy)
        else:
            source, names, problems = "observation", tuple(policy), []
        if problems := unknown_signals(names) + problems:
            raise ConfigError(source, problems)
        self.places = tuple(SIGNALS.index(name) for name in names)
        """Index of each input in ``SIGNALS``."""
        self.needs_reference = needs_reference(names)

    def observe(self, pose: Pose, start: float, reference: tuple[Pose, Velocity] | None) -> list[float]:
        """Return the observation (inputs,) at a pose; ``start`` is the start signal."""
        values = signals(pose, start, reference)
        return [values[place] for place in self.places]


def _problems(policy: Policy) -> list[str]:
    """Return what keeps a circuit from driving a rover, beside unknown signals."""
    outputs, problems = policy.motors.outputs, []
    if outputs != Velocity._fields:
        problems.append(f"its outputs are {', '.join(outputs)}; expected {', '.join(Velocity._fields)}")
    if not math.isclose(policy.tick_s, TICK_S):
        problems.append(f"its tick is {policy.tick_s:g} s, expected {TICK_S} s")
    return problems
