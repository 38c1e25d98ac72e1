"""What-ifs: a circuit simulated without each part, and with each parameter changed a little."""

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from rover_ncp.circuit.circuit import BOUNDS, ParameterKind
from rover_ncp.circuit.policy import Policy
from rover_ncp.core.config import ResultModel
from sim.learn.rollout import Rollout

FloatArray = NDArray[np.float64]

STEP = 0.01
"""Step of a parameter, as a fraction of the range between its bounds."""


class Knockout(ResultModel):
    """The simulation without a part."""

    kind: str
    """neuron or synapse"""
    name: str
    """of the neuron or synapse"""
    total: float
    """the return"""
    change: float
    """difference of the return to that of the intact circuit"""
    error_m: float
    """final position error"""
    error_rad: float
    """final heading error"""
    parked: bool
    """whether the rover parked"""

    @property
    def title(self) -> str:
        """The part's name for tables."""
        return f"neuron {self.name}" if self.kind == "neuron" else self.name.replace("->", "→")


class Sensitivity(ResultModel):
    """One parameter with its value, its steps, and the changes of the return."""

    kind: str
    """of parameter"""
    name: str
    """of the neuron or synapse"""
    unit: str
    """of the value and its steps"""
    value: float
    """the parameter's"""
    down: float
    """size of the step down; 0 at a bound"""
    up: float
    """size of the step up; 0 at a bound"""
    change_down: float
    """change of the return after the step down"""
    change_up: float
    """change of the return after the step up"""
    slope: float
    """change of the return per unit; 0 for a parameter that cannot change"""

    @property
    def worst(self) -> float:
        """Change of the return in the worse direction; positive if both improve it."""
        return min(self.change_down, self.change_up)

    @property
    def title(self) -> str:
        """The parameter's name for tables."""
        return f"{self.kind.replace('_', ' ')}, {self.name.replace('->', '→')}"


def knock_outs(policy: Policy, simulate: Callable[[Policy], Rollout], intact: float) -> tuple[Knockout, ...]:
    """Simulate a policy without each neuron and each synapse; ``intact`` is the return with all parts."""
    found = []
    for kind, name, rest in _damaged(policy):
        run = simulate(rest)
        ending = {key: getattr(run.verdict, key) for key in ("error_m", "error_rad", "parked")}
        found.append(Knockout(kind=kind, name=name, total=run.total, change=run.total - intact, **ending))
    return tuple(found)


def without_neuron(policy: Policy, neuron: str) -> Policy:
    """Return a policy without the outputs of a neuron.

    Its synapses are cut. It is held at the lowest potential, where a motor neuron commands nothing.
    """
    circuit = policy.circuit
    index = circuit.index(neuron)
    weight = np.where(circuit.source == index, 0.0, circuit.weight)
    held = dict(circuit.held)
    if neuron not in policy.sensing.neurons:  # an input clamps a sensory neuron
        held[index] = BOUNDS[ParameterKind.LEAK_POTENTIAL].lower
    return replace(policy, circuit=replace(circuit, weight=weight, held=held))


def without_synapse(policy: Policy, synapse: int) -> Policy:
    """Return a policy with the weight of one synapse set to 0."""
    weight = policy.circuit.weight.copy()
    weight[synapse] = 0.0
    return replace(policy, circuit=replace(policy.circuit, weight=weight))


def sensitivities(
    policy: Policy, score: Callable[[FloatArray], FloatArray], step: float = STEP
) -> tuple[Sensitivity, ...]:
    """Score a policy with each parameter moved by ``step`` of its range, at most to its bound.

    ``score`` returns the returns (n,) of vectors (n, P).
    """
    layout, intact = policy.layout(), policy.parameters()
    span = step * (layout.upper - layout.lower)
    down, up = np.minimum(span, intact - layout.lower), np.minimum(span, layout.upper - intact)
    vectors = np.concatenate([[intact], intact - np.diag(down), intact + np.diag(up)])
    returns = score(np.clip(vectors, layout.lower, layout.upper))
    lower, higher = (returns[1:] - returns[0]).reshape(2, -1)
    # One at a bound on both sides has no step: its slope is 0, not 0 / 0.
    slopes = (higher - lower) / np.where(down + up > 0.0, down + up, 1.0)
    return tuple(
        Sensitivity(
            kind=str(kind),
            name=name,
            unit=BOUNDS[kind].unit,
            value=intact[i],
            down=down[i],
            up=up[i],
            change_down=lower[i],
            change_up=higher[i],
            slope=slopes[i],
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


def _damaged(policy: Policy) -> Iterator[tuple[str, str, Policy]]:
    """Yield kind and name of each neuron and synapse, and the policy without it."""
    for neuron in policy.circuit.neurons:
        yield "neuron", neuron, without_neuron(policy, neuron)
    for synapse in range(policy.circuit.synapse_count):
        yield "synapse", policy.circuit.label(synapse), without_synapse(policy, synapse)
