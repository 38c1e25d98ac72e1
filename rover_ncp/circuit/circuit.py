"""A circuit of graded neurons and synapses, its parameters and the bounds they may take.

The model is that of Hasani et al. (ICRA 2020), supplement eq. 1-6; ``reference.py`` computes its steps.
Potentials are in mV, conductances in S, capacitances in F, sigma in 1/mV.

A gap junction is a physical, symmetric connection in the paper. Here, as in the published code, one synapse
is one line that feeds its destination only: published circuits behave the same only so.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import IntEnum, StrEnum
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rover_ncp.core.config import MAX_NAME, is_name
from rover_ncp.core.errors import ConfigError

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
Item = TypeVar("Item")

MAX_NEURONS = 256
RESTING_MV = -70.0
"""Every neuron's potential at the start of a run."""
MIDPOINT_MV = -40.0
"""Presynaptic potential at which a chemical synapse is half open, the same for all (mu in the paper)."""


class SynapseKind(IntEnum):
    """Effect of a synapse on its destination."""

    EXCITATORY = 0
    INHIBITORY = 1
    GAP = 2


REVERSAL_MV = {SynapseKind.EXCITATORY: 0.0, SynapseKind.INHIBITORY: -90.0}
"""Potential to which a chemical synapse pulls its destination (E_R in the paper)."""


class ParameterKind(StrEnum):
    """The kinds of numbers a search may change, in the order of a policy's parameter vector."""

    WEIGHT = "weight"
    SIGMA = "sigma"
    LEAK_POTENTIAL = "leak_potential"
    LEAK = "leak"
    CAPACITANCE = "capacitance"
    INPUT_LAYER = "input_layer"
    OUTPUT_LAYER = "output_layer"


class Bounds(NamedTuple):
    """The closed interval a parameter may lie in, and its unit."""

    lower: float
    upper: float
    unit: str = ""

    def __str__(self) -> str:
        return f"{self.lower:g}..{self.upper:g} {self.unit}".rstrip()


BOUNDS: Mapping[ParameterKind, Bounds] = {
    ParameterKind.WEIGHT: Bounds(0.0, 3.0, "S"),  # paper Table I, S2
    ParameterKind.SIGMA: Bounds(0.05, 0.5, "1/mV"),  # paper Table I, S2
    ParameterKind.LEAK_POTENTIAL: Bounds(-90.0, 0.0, "mV"),  # paper Table I, S2
    ParameterKind.LEAK: Bounds(0.05, 5.0, "S"),  # paper Table I, S2
    ParameterKind.CAPACITANCE: Bounds(0.001, 1.0, "F"),  # paper Table I, S2
    # The paper gives none for its linear layers. Ours let one entry of a layer carry an input of 1/3 of its
    # range across the whole range of a neuron, the ratio that the weights' bounds leave to a synapse.
    ParameterKind.INPUT_LAYER: Bounds(-3.0, 3.0),
    ParameterKind.OUTPUT_LAYER: Bounds(-3.0, 3.0),
}

DEFAULTS: Mapping[ParameterKind, float] = {
    ParameterKind.SIGMA: 0.1,
    ParameterKind.LEAK_POTENTIAL: RESTING_MV,
    ParameterKind.LEAK: 1.0,
    ParameterKind.CAPACITANCE: 0.05,
}
"""Defaults of the published file format for parameters that a file leaves out."""

_SYNAPSE_ARRAYS = (ParameterKind.WEIGHT, ParameterKind.SIGMA)
_NEURON_ARRAYS = (ParameterKind.LEAK_POTENTIAL, ParameterKind.LEAK, ParameterKind.CAPACITANCE)


@dataclass(frozen=True, eq=False)
class Circuit:
    """A circuit of n neurons and m synapses; valid by construction, and its arrays are read-only.

    Raises ConfigError, with every problem at once, for an index, a name or a value that cannot be.
    """

    name: str
    neurons: tuple[str, ...]
    """n different names; a neuron's index is its place here."""
    kind: IntArray
    """(m,) SynapseKind of each synapse."""
    source: IntArray
    """(m,) index of the presynaptic neuron."""
    destination: IntArray
    """(m,) index of the postsynaptic neuron."""
    weight: FloatArray
    """(m,) maximum conductance, S."""
    sigma: FloatArray
    """(m,) steepness of a chemical synapse, 1/mV; a gap junction has none and holds the default."""
    leak_potential: FloatArray
    """(n,) mV."""
    leak: FloatArray
    """(n,) leak conductance, S."""
    capacitance: FloatArray
    """(n,) F."""
    held: Mapping[int, float] = field(default_factory=dict)
    """Potentials in mV of neurons that never change (``const`` in the published format)."""

    def __post_init__(self) -> None:
        for name in ("kind", "source", "destination"):
            object.__setattr__(self, name, read_only(getattr(self, name), np.int64))
        for kind in (*_SYNAPSE_ARRAYS, *_NEURON_ARRAYS):
            object.__setattr__(self, kind, read_only(getattr(self, kind), np.float64))
        problems = self._shape_problems() or self._value_problems()
        if problems:
            raise ConfigError(f"circuit {self.name}" if is_name(self.name) else "circuit", problems)
        gaps = self.kind == SynapseKind.GAP
        sigma = np.where(gaps, DEFAULTS[ParameterKind.SIGMA], self.sigma)
        object.__setattr__(self, "sigma", read_only(sigma, np.float64))

    @property
    def size(self) -> int:
        """Number of neurons."""
        return len(self.neurons)

    @property
    def synapse_count(self) -> int:
        """Number of synapses, gap junctions included."""
        return len(self.kind)

    @property
    def chemical(self) -> NDArray[np.bool_]:
        """(m,) which synapses are chemical, so that their sigma counts."""
        chemical: NDArray[np.bool_] = self.kind != SynapseKind.GAP
        return chemical

    def index(self, neuron: str) -> int:
        """Return a neuron's index; raises ConfigError when the circuit has no such neuron."""
        try:
            return self.neurons.index(neuron)
        except ValueError:
            known = ", ".join(self.neurons)
            raise ConfigError(f"circuit {self.name}", [f"no neuron {neuron!r} (it has {known})"]) from None

    def label(self, synapse: int) -> str:
        """Return how a person names a synapse, like ``inhibitory PVD -> AVA``."""
        ends = (self.neurons[i] for i in (self.source[synapse], self.destination[synapse]))
        return SynapseKind(self.kind[synapse]).name.lower() + " " + " -> ".join(ends)

    def _shape_problems(self) -> list[str]:
        n, m = len(self.neurons), len(self.kind)
        if not 1 <= n <= MAX_NEURONS:
            return [f"1..{MAX_NEURONS} neurons are possible, got {n}"]
        problems = [f"two neurons are called {name!r}" for name in _repeated(self.neurons)]
        # What cannot be read from a policy's file is not made.
        problems += [
            f"name {name[:80]!r}: expected letters, digits and _ . + -, at most {MAX_NAME}, no sign first"
            for name in (self.name, *self.neurons)
            if not is_name(name)
        ]
        for names, count, what in (
            (("source", "destination", *_SYNAPSE_ARRAYS), m, "synapses"),
            (_NEURON_ARRAYS, n, "neurons"),
        ):
            problems += [
                f"{name} needs one value for each of {count} {what}"
                for name in names
                if getattr(self, name).shape != (count,)
            ]
        if problems:
            return problems
        for name, top in (("kind", len(SynapseKind)), ("source", n), ("destination", n)):
            values = getattr(self, name)
            problems += [
                f"synapse {s}: {name} {values[s]} is not in 0..{top - 1}"
                for s in np.flatnonzero((values < 0) | (values >= top))
            ]
        return problems + [f"held neuron {i} is not in 0..{n - 1}" for i in self.held if not 0 <= i < n]

    def _value_problems(self) -> list[str]:
        problems = []
        for kind in (*_SYNAPSE_ARRAYS, *_NEURON_ARRAYS):
            values, bounds = getattr(self, kind), BOUNDS[kind]
            # Written so that NaN is out of bounds, too.
            outside = ~((values >= bounds.lower) & (values <= bounds.upper))
            if kind is ParameterKind.SIGMA:
                outside &= self.chemical
            for i in np.flatnonzero(outside).tolist():
                owner = self.label(i) if kind in _SYNAPSE_ARRAYS else self.neurons[i]
                problems.append(f"{owner}: {kind} {values[i]:g} is outside {bounds}")
        bounds = BOUNDS[ParameterKind.LEAK_POTENTIAL]
        problems += [
            f"{self.neurons[i]}: held at {value:g} mV, outside {bounds}"
            for i, value in self.held.items()
            if not bounds.lower <= value <= bounds.upper
        ]
        triples = list(zip(self.kind, self.source, self.destination, strict=True))
        return problems + [
            f"the synapse {self.label(triples.index(triple))} appears twice" for triple in _repeated(triples)
        ]


def conductances(circuit: Circuit, potentials: FloatArray) -> FloatArray:
    """Return every synapse's conductance (m,) in S at potentials (n,) in mV.

    A chemical synapse's is w g(V_j), with g(V_j) = 1 / (1 + exp(-sigma (V_j - mu))); a gap junction's is
    its weight.
    """
    presynaptic = potentials[circuit.source]
    gate = 1.0 / (1.0 + np.exp(-circuit.sigma * (presynaptic - MIDPOINT_MV)))
    return circuit.weight * np.where(circuit.chemical, gate, 1.0)


def time_constants(circuit: Circuit, potentials: FloatArray) -> FloatArray:
    """Return tau_i = C_i / (G_i + all its synapses' conductances), (n,) in s, at a moment (paper eq. 5)."""
    total = circuit.leak.copy()
    np.add.at(total, circuit.destination, conductances(circuit, potentials))
    tau: FloatArray = circuit.capacitance / total
    return tau


def read_only(values: ArrayLike, dtype: type) -> NDArray[Any]:
    """Return a copy that cannot be written to."""
    array: NDArray[Any] = np.array(values, dtype)
    array.flags.writeable = False
    return array


def _repeated(items: Sequence[Item]) -> list[Item]:
    return [item for number, item in enumerate(items) if item in items[:number]]
