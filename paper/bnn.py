"""The text format of the published circuits (``.bnn``): one statement a line, ``#`` comments.

    size N        number of neurons, first of all
    cm i v        capacitance of neuron i, F               (0.05 where there is none)
    gleak i v     leak conductance, S                      (1)
    vleak i v     leak potential, mV                       (-70)
    const i v     the neuron is held at v mV
    ex  src dst w [sigma]     excitatory synapse, S and 1/mV       (sigma 0.1)
    inh src dst w [sigma]     inhibitory synapse
    gj  src dst w             gap junction; feeds dst alone, see ``circuit.py``

Neurons are numbers in it. They get the names of the wiring whose size they have: up to 11 neurons those of
the benchmarks, from 12 on those of parking. Published parking files have a thirteenth without any synapse.

A circuit with parking's motor neurons becomes a policy with parking's mappings, and any other one a circuit.
The policy's sensors are not clamped: the published code trains circuits so.
"""

from pathlib import Path

import numpy as np

from rover_ncp.circuit.circuit import DEFAULTS, MAX_NEURONS, Circuit, ParameterKind, SynapseKind
from rover_ncp.circuit.policy import Policy, parking_policy
from rover_ncp.circuit.policy_file import circuit_to_yaml, load_circuit, policy_to_yaml
from rover_ncp.core.config import name_from, read_filled
from rover_ncp.core.errors import ConfigError
from rover_ncp.core.files import require_writable, write_atomic

_VALUES = {
    "vleak": ParameterKind.LEAK_POTENTIAL,
    "gleak": ParameterKind.LEAK,
    "cm": ParameterKind.CAPACITANCE,
}
"""In the order of a circuit's fields."""
_SYNAPSES = {"ex": SynapseKind.EXCITATORY, "inh": SynapseKind.INHIBITORY, "gj": SynapseKind.GAP}


def circuit_from_bnn(text: str, name: str, source: str) -> Circuit:
    """Read a circuit; raises ConfigError naming ``source``, and the first line that cannot be read."""
    size = 0
    values: dict[str, dict[int, float]] = {word: {} for word in (*_VALUES, "const")}
    synapses: list[tuple[SynapseKind, int, int, float, float]] = []
    for number, line in enumerate(text.splitlines(), start=1):
        word, *fields = line.partition("#")[0].split() or [""]
        try:
            if word in _SYNAPSES:
                fields += [str(DEFAULTS[ParameterKind.SIGMA])] * (len(fields) == 3)
                origin, destination, weight, sigma = fields
                ends = _neuron(origin, size), _neuron(destination, size)
                synapses.append((_SYNAPSES[word], *ends, float(weight), float(sigma)))
            elif word in values:
                neuron, value = fields
                values[word][_neuron(neuron, size)] = float(value)
            elif word == "size" and not size:
                [count] = fields
                size = _neuron(count, MAX_NEURONS + 1)
            elif word:
                raise ValueError("unknown statement")
        except (ValueError, TypeError) as error:
            raise ConfigError(source, [f"line {number}: {line.strip()[:40]!r}: {error}"]) from error
    if not size:
        raise ConfigError(source, ["no size statement"])

    table = np.array(synapses, np.float64).reshape(-1, 5).T
    kind, origins, destinations = table[:3].astype(np.int64)
    potential, leak, capacitance = (
        np.array([values[word].get(i, DEFAULTS[_VALUES[word]]) for i in range(size)]) for word in _VALUES
    )
    known = load_circuit("tap_withdrawal" if size <= 11 else "parking").neurons
    neurons = tuple(known[i] if i < len(known) else f"N{i}" for i in range(size))
    wires = kind, origins, destinations, table[3], table[4]
    try:
        return Circuit(name, neurons, *wires, potential, leak, capacitance, held=values["const"])
    except ConfigError as error:
        raise ConfigError(source, error.problems) from error


def _neuron(text: str, size: int) -> int:
    number = int(text)
    if not 0 <= number < size:
        raise ValueError(f"neuron {number} is not in 0..{size - 1}" if size else "size must come first")
    return number


def load_bnn(path: Path) -> Circuit | Policy:
    """Load a circuit, or with parking's motor neurons a policy, named for its file.

    Raises FileError or ConfigError.
    """
    circuit = circuit_from_bnn(read_filled(path), name_from(path, "circuit"), str(path))
    return parking_policy(circuit, clamp=False) if {"RGT", "FWD"} <= set(circuit.neurons) else circuit


def convert(source: Path, out: Path, *, overwrite: bool = False) -> None:
    """Convert a published circuit into a policy file, or a circuit file. Raises FileError or ConfigError."""
    require_writable(out, overwrite=overwrite)
    found = load_bnn(source)
    write_atomic(out, policy_to_yaml(found) if isinstance(found, Policy) else circuit_to_yaml(found))
