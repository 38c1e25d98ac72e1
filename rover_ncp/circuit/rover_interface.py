"""The connection of a policy to a rover: its signals, and its outputs v and omega; needs no numba."""

import math

from rover_ncp.circuit.policy import Policy
from rover_ncp.core.errors import ConfigError
from rover_ncp.core.geometry import Pose, Velocity
from rover_ncp.course.course import TICK_S
from rover_ncp.course.signals import SIGNALS, needs_reference, signals


class RoverInterface:
    """A policy's connection to a rover. Raises ConfigError for a policy that drives none."""

    def __init__(self, policy: Policy) -> None:
        names, outputs = policy.sensing.inputs, policy.motors.outputs
        problems = []
        if unknown := [name for name in names if name not in SIGNALS]:
            known = ", ".join(SIGNALS)
            problems.append(
                f"unknown signals in its sensing: {', '.join(unknown)} (expected some of {known})"
            )
        if outputs != Velocity._fields:
            problems.append(f"its outputs are {', '.join(outputs)}; expected {', '.join(Velocity._fields)}")
        if not math.isclose(policy.tick_s, TICK_S):
            problems.append(f"its tick is {policy.tick_s:g} s, expected {TICK_S} s")
        if problems:
            raise ConfigError(f"policy {policy.circuit.name}", problems)
        self.places = tuple(SIGNALS.index(name) for name in names)
        """Index of each input in ``SIGNALS``."""
        self.needs_reference = needs_reference(names)

    def observe(self, pose: Pose, start: float, reference: tuple[Pose, Velocity] | None) -> list[float]:
        """Return the observation (inputs,) at a pose; ``start`` is the start signal."""
        values = signals(pose, start, reference)
        return [values[place] for place in self.places]
