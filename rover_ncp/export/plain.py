"""A policy as plain JSON for ports to other languages, and its wiring for the library ncps."""

import json

import numpy as np

from rover_ncp.circuit.circuit import MIDPOINT_MV, RESTING_MV, REVERSAL_MV, SynapseKind
from rover_ncp.circuit.policy import Policy
from rover_ncp.circuit.policy_file import policy_data
from rover_ncp.core.errors import ConfigError
from rover_ncp.export.vectors import Vectors


def json_file(policy: Policy, vectors: Vectors) -> str:
    """Return a policy file's content, the equations' constants and test vectors (``docs/export.md``)."""
    constants = {
        "resting_mV": RESTING_MV,
        "midpoint_mV": MIDPOINT_MV,
        "reversal_mV": {kind.name.lower(): potential for kind, potential in REVERSAL_MV.items()},
    }
    found = {
        "observations": vectors.observations.tolist(),
        "commands": vectors.commands.tolist(),
        "potentials_mV": vectors.potentials.tolist(),
    }
    content = policy_data(policy) | {"constants": constants, "test_vectors": found}
    return json.dumps(content, allow_nan=False) + "\n"


def ncps_file(policy: Policy) -> str:
    """Return the configuration that ``ncps.wirings.Wiring.from_config`` reads, with the neurons' names.

    Sensory neurons are the inputs; the units begin with the motor neurons, as ncps has its outputs. The
    library knows one polarity for a pair: a gap junction counts as excitatory. Raises ConfigError for a pair
    with synapses of both signs.
    """
    circuit = policy.circuit
    sensory = list(policy.sensing.neurons)
    motors = list(dict.fromkeys(neuron for channel in policy.motors.channels for neuron, _ in channel.sides))
    problems = [f"{name} is a sensory and a motor neuron" for name in motors if name in sensory]
    units = [*motors, *(name for name in circuit.neurons if name not in {*motors, *sensory})]
    inner = np.zeros((len(units), len(units)), np.int64)
    outer = np.zeros((len(sensory), len(units)), np.int64)
    for kind, source, destination in zip(circuit.kind, circuit.source, circuit.destination, strict=True):
        sign = -1 if kind == SynapseKind.INHIBITORY else 1
        a, b = circuit.neurons[source], circuit.neurons[destination]
        if b in sensory:  # an input overrides it
            continue
        matrix, row = (outer, sensory.index(a)) if a in sensory else (inner, units.index(a))
        if matrix[row, units.index(b)] == -sign:
            problems.append(f"{a} -> {b} has synapses of both signs, which a wiring of ncps cannot hold")
        matrix[row, units.index(b)] = sign
    if problems:
        raise ConfigError(f"policy {circuit.name}", problems)
    content = {
        "units": len(units),
        "adjacency_matrix": inner.tolist(),
        "sensory_adjacency_matrix": outer.tolist(),
        "input_dim": len(sensory),
        "output_dim": len(motors),
        "unit_names": units,
        "input_names": sensory,
    }
    return json.dumps(content) + "\n"
