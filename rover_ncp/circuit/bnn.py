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
from typing import Any

import numpy as np

from rover_ncp.circuit.circuit import (
    BOUNDS,
    DEFAULTS,
    MAXIMUM_NEURONS,
    Bounds,
    Circuit,
    ParameterKind,
    SynapseKind,
)
from rover_ncp.circuit.tap_withdrawal import NEURONS, PARKING_NEURONS
from rover_ncp.core.errors import ConfigError, FileError

_SYNAPSES = {"ex": SynapseKind.EXCITATORY, "inh": SynapseKind.INHIBITORY, "gj": SynapseKind.GAP}
_NEURON_VALUES = {
    "cm": ParameterKind.CAPACITANCE,
    "gleak": ParameterKind.LEAK,
    "vleak": ParameterKind.LEAK_POTENTIAL,
}
_WORDS = ", ".join(("size", *_NEURON_VALUES, "const", *_SYNAPSES))
_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?", re.ASCII)
_INDEX = re.compile(r"\d{1,6}", re.ASCII)
_SHOWN_PROBLEMS = 10


class _Wrong(Exception):
    """A statement that cannot be."""


class _Parser:
    """Collects statements; each method handles the arguments of one, or raises _Wrong."""

    def __init__(self) -> None:
        self.size: int | None = None
        self.values: dict[tuple[ParameterKind, int], float] = {}
        self.held: dict[int, float] = {}
        self.synapses: dict[tuple[SynapseKind, int, int], tuple[float, float]] = {}

    def statement(self, words: list[str]) -> None:
        word, arguments = words[0], words[1:]
        if word == "size":
            self._size(arguments)
        elif self.size is None:
            raise _Wrong("a size statement must come first")
        elif word in _NEURON_VALUES:
            kind = _NEURON_VALUES[word]
            neuron, value = self._neuron_value(word, arguments, BOUNDS[kind])
            _once(self.values, (kind, neuron), value, f"{word} {neuron}")
        elif word == "const":
            neuron, value = self._neuron_value(word, arguments, BOUNDS[ParameterKind.LEAK_POTENTIAL])
            _once(self.held, neuron, value, f"const {neuron}")
        elif word in _SYNAPSES:
            self._synapse(word, arguments)
        else:
            raise _Wrong(f"unknown statement {word[:20]!r} (expected one of {_WORDS})")

    def _size(self, arguments: list[str]) -> None:
        _count("size", arguments, "N", 1)
        if self.size is not None:
            raise _Wrong("a second size statement")
        if not _INDEX.fullmatch(arguments[0]) or not 1 <= int(arguments[0]) <= MAXIMUM_NEURONS:
            raise _Wrong(f"size must be in 1..{MAXIMUM_NEURONS}, got {arguments[0][:20]!r}")
        self.size = int(arguments[0])

    def _neuron_value(self, word: str, arguments: list[str], bounds: Bounds) -> tuple[int, float]:
        _count(word, arguments, "neuron value", 2)
        return self._index(arguments[0]), _number(word, arguments[1], bounds)

    def _synapse(self, word: str, arguments: list[str]) -> None:
        kind = _SYNAPSES[word]
        if kind is SynapseKind.GAP:
            _count(word, arguments, "source destination weight", 3)
        else:
            _count(word, arguments, "source destination weight [sigma]", 3, 4)
        source, destination = self._index(arguments[0]), self._index(arguments[1])
        weight = _number("weight", arguments[2], BOUNDS[ParameterKind.WEIGHT])
        sigma = DEFAULTS[ParameterKind.SIGMA]
        if len(arguments) == 4:
            sigma = _number("sigma", arguments[3], BOUNDS[ParameterKind.SIGMA])
        key = (kind, source, destination)
        _once(self.synapses, key, (weight, sigma), f"{word} {source} {destination}")

    def _index(self, text: str) -> int:
        assert self.size is not None
        if not _INDEX.fullmatch(text) or int(text) >= self.size:
            raise _Wrong(f"neuron {text[:20]!r} is not in 0..{self.size - 1}")
        return int(text)

    def circuit(self, name: str) -> Circuit:
        assert self.size is not None
        keys = list(self.synapses)
        columns = [np.array([key[i] for key in keys], np.int64) for i in range(3)]
        numbers = np.array(list(self.synapses.values()), np.float64).reshape(len(keys), 2)
        per_neuron = {
            str(kind): np.array(
                [self.values.get((kind, i), DEFAULTS[kind]) for i in range(self.size)], np.float64
            )
            for kind in _NEURON_VALUES.values()
        }
        return Circuit(
            name=name,
            neurons=_names(self.size),
            kind=columns[0],
            source=columns[1],
            destination=columns[2],
            weight=numbers[:, 0],
            sigma=numbers[:, 1],
            held=self.held,
            **per_neuron,
        )


def circuit_from_bnn(text: str, name: str, source: str) -> Circuit:
    """Read a circuit; raises ConfigError naming ``source`` and the line of every wrong statement."""
    if not text.strip():
        raise FileError(f"{source}: the file is empty")
    parser, problems = _Parser(), []
    for number, line in enumerate(text.splitlines(), start=1):
        words = line.partition("#")[0].split()
        if not words:
            continue
        try:
            parser.statement(words)
        except _Wrong as wrong:
            problems.append(f"line {number}: {wrong}")
            if parser.size is None:  # nothing after it can be judged
                break
    if parser.size is None and not problems:
        problems.append("no size statement")
    if problems:
        more = len(problems) - _SHOWN_PROBLEMS
        shown = problems[:_SHOWN_PROBLEMS] + ([f"and {more} more"] if more > 0 else [])
        raise ConfigError(source, shown)
    return parser.circuit(name)


def circuit_to_bnn(circuit: Circuit) -> str:
    """Write a circuit; read back, every number has the same bits. Names other than the wiring's are lost."""
    lines = [f"size {circuit.size}"]
    for i in range(circuit.size):
        lines.append(f"cm {i} {float(circuit.capacitance[i])!r}")
        lines.append(f"gleak {i} {float(circuit.leak[i])!r}")
    lines += [f"vleak {i} {float(circuit.leak_potential[i])!r}" for i in range(circuit.size)]
    lines += [f"const {i} {float(value)!r}" for i, value in circuit.held.items()]
    words = {kind: word for word, kind in _SYNAPSES.items()}
    for s in range(circuit.synapse_count):
        kind = SynapseKind(circuit.kind[s])
        line = f"{words[kind]} {circuit.source[s]} {circuit.destination[s]} {float(circuit.weight[s])!r}"
        lines.append(line if kind is SynapseKind.GAP else f"{line} {float(circuit.sigma[s])!r}")
    return "\n".join(lines) + "\n"


def _names(size: int) -> tuple[str, ...]:
    known = NEURONS if size <= len(NEURONS) else PARKING_NEURONS
    return tuple(known[i] if i < len(known) else f"N{i}" for i in range(size))


def _count(word: str, arguments: list[str], expected: str, *counts: int) -> None:
    if len(arguments) not in counts:
        raise _Wrong(f"expected '{word} {expected}', got {len(arguments)} values")


def _number(what: str, text: str, bounds: Bounds) -> float:
    if not _NUMBER.fullmatch(text):
        raise _Wrong(f"{what} must be a number in {bounds}, got {text[:20]!r}")
    value = float(text)
    if not bounds.lower <= value <= bounds.upper:
        raise _Wrong(f"{what} {text[:20]} is outside {bounds}")
    return value


def _once(table: dict[Any, Any], key: Any, value: Any, what: str) -> None:
    if key in table:
        raise _Wrong(f"{what} appears twice")
    table[key] = value
