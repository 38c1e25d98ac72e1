"""Sensitivity of the return to each parameter: each is moved a little down and up, all others kept.

"A little" is a hundredth of the range that search may use, less where a bound is nearer.
"""

from dataclasses import dataclass

import numpy as np

from rover_ncp.circuit.circuit import BOUNDS, ParameterKind
from rover_ncp.circuit.policy import Policy
from rover_ncp.course.course import Course
from sim.learn.evaluator import Evaluator

STEP = 0.01
"""Step, as a fraction of the range between a parameter's bounds."""


@dataclass(frozen=True)
class Sensitivity:
    """One parameter: its value, how far it was moved, and what the return became."""

    kind: str
    name: str
    unit: str
    value: float
    down: float
    up: float
    """By how much it was moved; 0 at a bound."""
    change_down: float
    change_up: float
    """Change of the return."""

    @property
    def slope(self) -> float:
        """Change of the return per unit; 0 for a parameter that cannot move."""
        span = self.down + self.up
        return (self.change_up - self.change_down) / span if span else 0.0

    @property
    def worst(self) -> float:
        """Change of the return in the worse of both directions; positive if both improve it."""
        return min(self.change_down, self.change_up)


def sensitivities(policy: Policy, course: Course, step: float = STEP) -> tuple[Sensitivity, ...]:
    """Score a policy with each parameter moved by ``step`` of its range. Raises ConfigError."""
    layout, intact = policy.layout(), policy.parameters()
    span = step * (layout.upper - layout.lower)
    down, up = np.minimum(span, intact - layout.lower), np.minimum(span, layout.upper - intact)
    vectors = np.tile(intact, (2 * layout.size + 1, 1))
    every = np.arange(layout.size)
    vectors[1 + every, every] = intact - down
    vectors[1 + layout.size + every, every] = intact + up
    returns = Evaluator(policy, course).returns(np.clip(vectors, layout.lower, layout.upper))
    base, lower, higher = returns[0], returns[1 : 1 + layout.size], returns[1 + layout.size :]
    return tuple(
        Sensitivity(
            kind=str(kind),
            name=name,
            unit=BOUNDS[kind].unit,
            value=float(intact[i]),
            down=float(down[i]),
            up=float(up[i]),
            change_down=float(lower[i] - base),
            change_up=float(higher[i] - base),
        )
        for i, (kind, name) in enumerate(parameter_names(policy))
    )


def parameter_names(policy: Policy) -> list[tuple[ParameterKind, str]]:
    """Return kind and owner of each parameter, in the order of the policy's vector (P,)."""
    circuit = policy.circuit
    names: list[tuple[ParameterKind, str]] = []
    for block in policy.layout().blocks:
        if block.kind is ParameterKind.WEIGHT:
            owners = [circuit.label(s) for s in range(circuit.synapse_count)]
        elif block.kind is ParameterKind.SIGMA:
            owners = [circuit.label(int(s)) for s in np.flatnonzero(circuit.chemical)]
        elif block.kind in {ParameterKind.INPUT_LAYER, ParameterKind.OUTPUT_LAYER}:
            layer = getattr(policy, block.kind)
            owners = [f"row {row}, column {column}" for row, column in np.ndindex(layer.shape)]
        else:
            owners = list(circuit.neurons)
        names += [(block.kind, owner) for owner in owners]
    return names
