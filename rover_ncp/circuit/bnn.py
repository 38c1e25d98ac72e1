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
"""

import re

import numpy as np

from rover_ncp.circuit.circuit import BOUNDS, DEFAULTS, MAXIMUM_NEURONS, Circuit, ParameterKind, SynapseKind
from rover_ncp.core.errors import ConfigError

_VALUES = {
    "cm": ParameterKind.CAPACITANCE,
    "gleak": ParameterKind.LEAK,
    "vleak": ParameterKind.LEAK_POTENTIAL,
    "const": ParameterKind.LEAK_POTENTIAL,
}
_SYNAPSES = {"ex": SynapseKind.EXCITATORY, "inh": SynapseKind.INHIBITORY, "gj": SynapseKind.GAP}
_USAGE = {
    "size": "N",
    **dict.fromkeys(_VALUES, "neuron value"),
    "ex": "source destination weight [sigma]",
    "inh": "source destination weight [sigma]",
    "gj": "source destination weight",
}
_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?", re.ASCII)
_INDEX = re.compile(r"\d{1,6}", re.ASCII)
_SHOWN_PROBLEMS = 10
_NEURONS = ("PVD", "PLM", "AVA", "AVD", "PVC", "AVB", "AVM", "ALM", "DVA", "FWD", "REV")
_PARKING_NEURONS = (*_NEURONS[:9], "LFT", "RGT", "FWD")


class _Wrong(Exception):
    """A statement that cannot be."""


class _Statements:
    """The statements read so far."""

    def __init__(self) -> None:
        self.size = 0
        self.values: dict[tuple[str, int], float] = {}
        self.synapses: dict[tuple[str, int, int], tuple[float, float]] = {}

    def read(self, words: list[str]) -> None:
        """Read one statement. Raises _Wrong."""
        match words:
            case ["size", count]:
                if self.size:
                    raise _Wrong("a second size statement")
                if not _INDEX.fullmatch(count) or not 1 <= int(count) <= MAXIMUM_NEURONS:
                    raise _Wrong(f"size must be in 1..{MAXIMUM_NEURONS}, got {count[:20]!r}")
                self.size = int(count)
            case [word, *_] if word != "size" and not self.size:
                raise _Wrong("a size statement must come first")
            case ["cm" | "gleak" | "vleak" | "const" as word, neuron, value]:
                at = word, self._index(neuron)
                number = _number(word, value, _VALUES[word])
                if at in self.values:
                    raise _Wrong(f"{word} {at[1]} appears twice")
                self.values[at] = number
            case ["ex" | "inh" as word, source, destination, weight, sigma]:
                self._add_synapse(word, source, destination, weight, sigma)
            case ["ex" | "inh" | "gj" as word, source, destination, weight]:
                self._add_synapse(word, source, destination, weight)
            case [word, *rest] if word in _USAGE:
                raise _Wrong(f"expected '{word} {_USAGE[word]}', got {len(rest)} values")
            case _:
                expected = ", ".join(_USAGE)
                raise _Wrong(f"unknown statement {words[0][:20]!r} (expected one of {expected})")

    def _add_synapse(self, word: str, source: str, destination: str, weight: str, sigma: str = "") -> None:
        ends = word, self._index(source), self._index(destination)
        conductance, steepness = (
            _number("weight", weight, ParameterKind.WEIGHT),
            DEFAULTS[ParameterKind.SIGMA],
        )
        if sigma:
            steepness = _number("sigma", sigma, ParameterKind.SIGMA)
        if ends in self.synapses:
            raise _Wrong(f"{word} {ends[1]} {ends[2]} appears twice")
        self.synapses[ends] = conductance, steepness

    def _index(self, text: str) -> int:
        if not _INDEX.fullmatch(text) or int(text) >= self.size:
            raise _Wrong(f"neuron {text[:20]!r} is not in 0..{self.size - 1}")
        return int(text)

    def circuit(self, name: str) -> Circuit:
        """Return the circuit that they make."""

        def per_neuron(word: str) -> list[float]:
            default = DEFAULTS[_VALUES[word]]
            return [self.values.get((word, i), default) for i in range(self.size)]

        known = _NEURONS if self.size <= len(_NEURONS) else _PARKING_NEURONS
        return Circuit(
            name=name,
            neurons=tuple(known[i] if i < len(known) else f"N{i}" for i in range(self.size)),
            kind=np.array([_SYNAPSES[word] for word, _, _ in self.synapses], np.int64),
            source=np.array([source for _, source, _ in self.synapses], np.int64),
            destination=np.array([destination for _, _, destination in self.synapses], np.int64),
            weight=np.array([weight for weight, _ in self.synapses.values()]),
            sigma=np.array([sigma for _, sigma in self.synapses.values()]),
            leak_potential=np.array(per_neuron("vleak")),
            leak=np.array(per_neuron("gleak")),
            capacitance=np.array(per_neuron("cm")),
            held={i: value for (word, i), value in self.values.items() if word == "const"},
        )


def circuit_from_bnn(text: str, name: str, source: str) -> Circuit:
    """Read a circuit; raises ConfigError naming ``source`` and the line of every wrong statement."""
    statements, problems = _Statements(), []
    for number, line in enumerate(text.splitlines(), start=1):
        if words := line.partition("#")[0].split():
            try:
                statements.read(words)
            except _Wrong as wrong:
                problems.append(f"line {number}: {wrong}")
                if not statements.size:  # nothing after it can be judged
                    break
    if not statements.size and not problems:
        problems.append("no size statement")
    if len(problems) > _SHOWN_PROBLEMS:
        problems[_SHOWN_PROBLEMS:] = [f"and {len(problems) - _SHOWN_PROBLEMS} more"]
    if problems:
        raise ConfigError(source, problems)
    return statements.circuit(name)


def _number(what: str, text: str, kind: ParameterKind) -> float:
    bounds = BOUNDS[kind]
    if not _NUMBER.fullmatch(text):
        raise _Wrong(f"{what} must be a number in {bounds}, got {text[:20]!r}")
    value = float(text)
    if not bounds.lower <= value <= bounds.upper:
        raise _Wrong(f"{what} {text[:20]} is outside {bounds}")
    return value
