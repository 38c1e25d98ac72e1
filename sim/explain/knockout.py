"""Knockouts: the drives of a circuit without one neuron or one synapse, simulated again.

A neuron is taken out by cutting all that leaves it and holding it at the lowest potential, where no motor
neuron asks for anything; a synapse by a weight of 0.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from rover_ncp.circuit.circuit import BOUNDS, ParameterKind
from rover_ncp.circuit.policy import Policy
from rover_ncp.course.course import Course
from sim.learn.rollout import Rollout, rollout


@dataclass(frozen=True)
class Knockout:
    """A drive without a part; the changes are against the intact circuit's."""

    kind: str
    """neuron or synapse."""
    name: str
    total: float
    """The return."""
    change: float
    error_m: float
    error_rad: float
    """To the goal at the end."""
    parked: bool


def knock_outs(
    policy: Policy, course: Course, intact: Rollout, on_progress: Callable[[], None] = lambda: None
) -> tuple[Knockout, ...]:
    """Drive the course once without each neuron and each synapse. Raises ConfigError."""
    found = []
    for kind, name, damaged in _damaged(policy):
        run = rollout(damaged, course)
        found.append(
            Knockout(
                kind=kind,
                name=name,
                total=run.total,
                change=run.total - intact.total,
                error_m=run.verdict.error_m,
                error_rad=run.verdict.error_rad,
                parked=run.verdict.parked,
            )
        )
        on_progress()
    return tuple(found)


def without_neuron(policy: Policy, neuron: str) -> Policy:
    """Return a policy with all outputs of a neuron removed, to other neurons and to motors."""
    circuit = policy.circuit
    index = circuit.index(neuron)
    weight = np.where(circuit.source == index, 0.0, circuit.weight)
    # A sensory neuron is driven by its input, whatever its own parameters are.
    held = dict(circuit.held)
    if neuron not in policy.sensing.neurons:
        held[index] = BOUNDS[ParameterKind.LEAK_POTENTIAL].lower
    return replace(policy, circuit=replace(circuit, weight=weight, held=held))


def without_synapse(policy: Policy, synapse: int) -> Policy:
    """Return a policy with one synapse cut."""
    weight = policy.circuit.weight.copy()
    weight[synapse] = 0.0
    return replace(policy, circuit=replace(policy.circuit, weight=weight))


def _damaged(policy: Policy) -> Iterator[tuple[str, str, Policy]]:
    for neuron in policy.circuit.neurons:
        yield "neuron", neuron, without_neuron(policy, neuron)
    for synapse in range(policy.circuit.synapse_count):
        yield "synapse", policy.circuit.label(synapse), without_synapse(policy, synapse)
