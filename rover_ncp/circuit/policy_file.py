"""Circuits and policies as YAML files.

A policy file determines the circuit's behaviour, with neurons and synapses by name. Read back, every number
has the same bits, and so has every trajectory.
"""

from pathlib import Path
from typing import Any, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from rover_ncp.circuit.circuit import BOUNDS, DEFAULTS, Circuit, ParameterKind, SynapseKind
from rover_ncp.circuit.motors import Motors
from rover_ncp.circuit.own_policy import is_own
from rover_ncp.circuit.policy import Policy
from rover_ncp.circuit.sensing import Sensing
from rover_ncp.core.config import (
    Name,
    StrictModel,
    dump_yaml,
    load_yaml,
    parse_yaml,
    read_filled,
    read_yaml,
)
from rover_ncp.core.errors import ConfigError, UsageError
from rover_ncp.core.files import resolve, shipped_names, write_atomic


def _number(kind: ParameterKind, meaning: str) -> Any:
    """Return the field of a number, whose bounds the circuit checks."""
    return Field(description=f"{meaning}, {BOUNDS[kind]}")


Layer = tuple[tuple[float, ...], ...]


class _Neuron(StrictModel):
    name: str = Field(description="Different from those of the other neurons.")
    capacitance: float = _number(ParameterKind.CAPACITANCE, "Capacitance")
    leak: float = _number(ParameterKind.LEAK, "Conductance to the leak potential")
    leak_potential: float = _number(ParameterKind.LEAK_POTENTIAL, "Potential at rest, without synapses")
    held_mV: float | None = Field(
        default=None, description="Constant potential of a neuron that never changes, -90..0 mV"
    )


class _Synapse(StrictModel):
    kind: Literal["excitatory", "inhibitory", "gap"]
    """Chemical (the first two), or a gap junction."""
    source: str
    """Presynaptic neuron."""
    destination: str
    """Postsynaptic neuron; a gap junction, too, feeds this neuron only."""
    weight: float = _number(ParameterKind.WEIGHT, "Conductance when open")
    sigma: float | None = Field(
        default=None, description="Steepness of a chemical synapse, 0.05..0.5 1/mV; a gap junction has none"
    )

    @model_validator(mode="after")
    def _sigma_fits(self) -> Self:
        if (self.sigma is None) != (self.kind == "gap"):
            raise ValueError("a chemical synapse needs sigma, a gap junction has none")
        return self


class _Circuit(StrictModel):
    name: str
    """Name of the wiring, for messages and reports."""
    neurons: tuple[_Neuron, ...]
    """Sensory neurons, interneurons and motor neurons."""
    synapses: tuple[_Synapse, ...]
    """At most one of a kind from one neuron to another."""


class _CircuitFile(_Circuit):
    format: Literal[1]


class _PolicyFile(StrictModel):
    format: Literal[1]
    circuit: _Circuit
    sensing: Sensing
    """From inputs to potentials of sensory neurons."""
    motors: Motors
    """From potentials of motor neurons to outputs."""
    input_layer: Layer | None = None
    """A row for each channel of the sensing, a column for each input."""
    output_layer: Layer | None = None
    """A row for each output, a column for each channel of the motors."""
    dt_s: float
    substeps: int
    courses: tuple[Name, ...]
    provenance: dict[str, Any]


def load_policy(name_or_path: str | Path) -> Policy:
    """Load a shipped policy by name, or a policy file by path. Raises UsageError, also as a subclass."""
    if is_own(str(name_or_path)):
        raise UsageError(
            f"{name_or_path}: a policy in Python, expected one of a circuit; eval and deploy take both"
        )
    path = resolve("policies", name_or_path)
    return policy_from_yaml(read_filled(path), str(path))


def load_circuit(name_or_path: str | Path) -> Circuit:
    """Load a shipped circuit by name, or a circuit file by path."""
    path = resolve("circuits", name_or_path)
    return _circuit(load_yaml(path, _CircuitFile), str(path), "$")


def load_start(name_or_path: str | Path) -> Circuit | Policy:
    """Load what a training starts from: a circuit, or a policy, which also has sensing and motors.

    A name that both have is the circuit's.
    """
    is_policy = str(name_or_path) in {*shipped_names("policies")} - {*shipped_names("circuits")}
    path = resolve("policies" if is_policy else "circuits", name_or_path)
    data = read_yaml(read_filled(path), str(path))
    return load_policy(path) if isinstance(data, dict) and "sensing" in data else load_circuit(path)


def save_policy(path: str | Path, policy: Policy) -> None:
    """Write a policy file, whole or not at all. Raises FileError when the place cannot be written."""
    write_atomic(Path(path), policy_to_yaml(policy))


def policy_from_yaml(text: str, source: str) -> Policy:
    """Read a policy from the text of its file; raises ConfigError naming ``source`` and every bad value."""
    file = parse_yaml(text, _PolicyFile, source)
    circuit = _circuit(file.circuit, source, "$.circuit")
    try:
        return Policy(
            circuit=circuit,
            sensing=file.sensing,
            motors=file.motors,
            input_layer=_layer(file.input_layer, "input_layer"),
            output_layer=_layer(file.output_layer, "output_layer"),
            dt_s=file.dt_s,
            substeps=file.substeps,
            courses=file.courses,
            provenance=file.provenance,
        )
    except ConfigError as error:
        raise ConfigError(source, [f"$.{problem}" for problem in error.problems]) from error


def policy_to_yaml(policy: Policy) -> str:
    """Return the text of a policy's file."""
    return dump_yaml(policy_data(policy))


def policy_data(policy: Policy) -> dict[str, Any]:
    """Return the content of a policy's file as plain values."""
    data: dict[str, Any] = {
        "format": 1,
        "circuit": _circuit_data(policy.circuit),
        "sensing": policy.sensing.model_dump(exclude_none=True),
        "motors": policy.motors.model_dump(exclude_none=True),
    }
    for name in ("input_layer", "output_layer"):
        layer = getattr(policy, name)
        if layer is not None:
            data[name] = layer.tolist()
    data |= {
        "dt_s": policy.dt_s,
        "substeps": policy.substeps,
        "courses": list(policy.courses),
        "provenance": dict(policy.provenance),
    }
    return data


def circuit_to_yaml(circuit: Circuit) -> str:
    """Return the text of a circuit's file."""
    return dump_yaml({"format": 1, **_circuit_data(circuit)})


def _layer(rows: Layer | None, name: str) -> NDArray[np.float64] | None:
    try:
        return None if rows is None else np.array(rows, np.float64)
    except ValueError as error:
        raise ConfigError("", [f"{name}: all rows must have the same length"]) from error


def _circuit(file: _Circuit, source: str, where: str) -> Circuit:
    """Turn names into indices; every problem with the path of its value."""
    neurons = [neuron.name for neuron in file.neurons]
    problems = [
        f"{where}.synapses[{s}].{end}: there is no neuron {name!r}"
        for s, synapse in enumerate(file.synapses)
        for end, name in (("source", synapse.source), ("destination", synapse.destination))
        if name not in neurons
    ]
    if problems:
        raise ConfigError(source, problems)
    sigma_without = DEFAULTS[ParameterKind.SIGMA]
    try:
        return Circuit(
            name=file.name,
            neurons=tuple(neurons),
            kind=np.array([SynapseKind[s.kind.upper()] for s in file.synapses], np.int64),
            source=np.array([neurons.index(s.source) for s in file.synapses], np.int64),
            destination=np.array([neurons.index(s.destination) for s in file.synapses], np.int64),
            weight=np.array([s.weight for s in file.synapses], np.float64),
            sigma=np.array(
                [sigma_without if s.sigma is None else s.sigma for s in file.synapses], np.float64
            ),
            leak_potential=np.array([n.leak_potential for n in file.neurons]),
            leak=np.array([n.leak for n in file.neurons]),
            capacitance=np.array([n.capacitance for n in file.neurons]),
            held={i: n.held_mV for i, n in enumerate(file.neurons) if n.held_mV is not None},
        )
    except ConfigError as error:
        raise ConfigError(source, [f"{where}: {problem}" for problem in error.problems]) from error


def _circuit_data(circuit: Circuit) -> dict[str, Any]:
    neurons = [
        {
            "name": name,
            "capacitance": float(circuit.capacitance[i]),
            "leak": float(circuit.leak[i]),
            "leak_potential": float(circuit.leak_potential[i]),
            "held_mV": circuit.held.get(i),
        }
        for i, name in enumerate(circuit.neurons)
    ]
    synapses = [
        {
            "kind": SynapseKind(circuit.kind[s]).name.lower(),
            "source": circuit.neurons[circuit.source[s]],
            "destination": circuit.neurons[circuit.destination[s]],
            "weight": float(circuit.weight[s]),
            "sigma": float(circuit.sigma[s]) if circuit.chemical[s] else None,
        }
        for s in range(circuit.synapse_count)
    ]
    data = {"name": circuit.name, "neurons": neurons, "synapses": synapses}
    return _Circuit.model_validate(data).model_dump(exclude_none=True)
