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

    python -m paper.bnn IN.bnn OUT.yaml

writes a circuit with parking's motor neurons as a policy with parking's mappings, and any other one as a
circuit. The policy's sensors are not clamped: the published code trains circuits so.
"""

import re
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from paper.__main__ import run_command_line
from rover_ncp.circuit.circuit import DEFAULTS, MAX_NEURONS, Circuit, ParameterKind, SynapseKind
from rover_ncp.circuit.policy import Policy, parking_policy
from rover_ncp.circuit.policy_file import circuit_to_yaml, policy_to_yaml
from rover_ncp.core.config import name_from, read_filled
from rover_ncp.core.console import Overwrite
from rover_ncp.core.errors import ConfigError
from rover_ncp.core.files import require_writable, write_atomic

_VALUES = {
    "cm": ParameterKind.CAPACITANCE,
    "gleak": ParameterKind.LEAK,
    "vleak": ParameterKind.LEAK_POTENTIAL,
    "const": ParameterKind.LEAK_POTENTIAL,
}
_SYNAPSES = {"ex": SynapseKind.EXCITATORY, "inh": SynapseKind.INHIBITORY, "gj": SynapseKind.GAP}
_USAGE = {
    **dict.fromkeys(_VALUES, "neuron value"),
    "ex": "source destination weight [sigma]",
    "inh": "source destination weight [sigma]",
    "gj": "source destination weight",
}
_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?", re.ASCII)
_INDEX = re.compile(r"\d{1,6}", re.ASCII)
_NEURONS = ("PVD", "PLM", "AVA", "AVD", "PVC", "AVB", "AVM", "ALM", "DVA", "FWD", "REV")
_PARKING_NEURONS = (*_NEURONS[:9], "LFT", "RGT", "FWD")

_Synapse = tuple[SynapseKind, int, int, float, float]


def circuit_from_bnn(text: str, name: str, source: str) -> Circuit:
    """Read a circuit; raises ConfigError naming ``source``, and the line of every unreadable statement."""
    size, problems = 0, []
    values: dict[tuple[str, int], float] = {}
    synapses: list[_Synapse] = []
    for number, line in enumerate(text.splitlines(), start=1):
        words = line.partition("#")[0].split()
        if not words:
            continue
        try:
            if not size:
                size = _size(words)
                continue
            word, indices, numbers = _statement(words, size)
            if word in _SYNAPSES:
                weight, sigma, *_ = (*numbers, DEFAULTS[ParameterKind.SIGMA])
                synapses.append((_SYNAPSES[word], indices[0], indices[1], weight, sigma))
            elif (word, *indices) in values:
                raise ValueError(f"{word} {indices[0]} appears twice")
            else:
                values[word, indices[0]] = numbers[0]
        except ValueError as error:
            problems.append(f"line {number}: {error}")
            if not size:  # no index can be checked without it
                break
    if not size and not problems:
        problems.append("no size statement")
    if problems:
        raise ConfigError(source, problems)
    try:
        return _circuit(name, size, values, synapses)
    except ConfigError as error:
        raise ConfigError(source, error.problems) from error


def _circuit(name: str, size: int, values: dict[tuple[str, int], float], synapses: list[_Synapse]) -> Circuit:
    def per_neuron(word: str) -> list[float]:
        return [values.get((word, i), DEFAULTS[_VALUES[word]]) for i in range(size)]

    kind, origin, destination, weight, sigma = zip(*synapses, strict=True) if synapses else ((),) * 5
    known = _NEURONS if size <= len(_NEURONS) else _PARKING_NEURONS
    return Circuit(
        name=name,
        neurons=tuple(known[i] if i < len(known) else f"N{i}" for i in range(size)),
        kind=np.array(kind, np.int64),
        source=np.array(origin, np.int64),
        destination=np.array(destination, np.int64),
        weight=np.array(weight, np.float64),
        sigma=np.array(sigma, np.float64),
        leak_potential=np.array(per_neuron("vleak")),
        leak=np.array(per_neuron("gleak")),
        capacitance=np.array(per_neuron("cm")),
        held={i: value for (word, i), value in values.items() if word == "const"},
    )


def _size(words: list[str]) -> int:
    if words[0] != "size":
        raise ValueError("a size statement must come first")
    count = words[1] if len(words) == 2 else ""
    if not _INDEX.fullmatch(count) or not 1 <= int(count) <= MAX_NEURONS:
        raise ValueError(f"expected 'size N', N in 1..{MAX_NEURONS}, got {' '.join(words)[:40]!r}")
    return int(count)


def _statement(words: list[str], size: int) -> tuple[str, list[int], list[float]]:
    """Return a statement's word, its neurons and its numbers."""
    word, *texts = words
    if word not in _USAGE:
        raise ValueError(f"unknown statement {word[:20]!r} (expected one of {', '.join(_USAGE)})")
    neurons, usage = (2 if word in _SYNAPSES else 1), _USAGE[word].split()
    if not neurons + 1 <= len(texts) <= len(usage):
        raise ValueError(f"expected '{word} {_USAGE[word]}', got {len(texts)} values")
    return word, [_index(text, size) for text in texts[:neurons]], [_number(text) for text in texts[neurons:]]


def _index(text: str, size: int) -> int:
    if not _INDEX.fullmatch(text) or int(text) >= size:
        raise ValueError(f"neuron {text[:20]!r} is not in 0..{size - 1}")
    return int(text)


def _number(text: str) -> float:
    if not _NUMBER.fullmatch(text):
        raise ValueError(f"expected a number, got {text[:20]!r}")
    return float(text)


def load_bnn(path: Path) -> Circuit | Policy:
    """Load a circuit, or with parking's motor neurons a policy, named for its file.

    Raises FileError or ConfigError.
    """
    circuit = circuit_from_bnn(read_filled(path), name_from(path, "circuit"), str(path))
    return parking_policy(circuit, clamp=False) if {"RGT", "FWD"} <= set(circuit.neurons) else circuit


def convert(
    source: Annotated[Path, typer.Argument(metavar="IN.bnn", help="Circuit in the published format.")],
    out: Annotated[Path, typer.Argument(metavar="OUT.yaml", help="Policy or circuit file to write.")],
    overwrite: Overwrite = False,
) -> None:
    """Convert a published circuit into a policy file, or a circuit file."""
    require_writable(out, overwrite=overwrite)
    found = load_bnn(source)
    write_atomic(out, policy_to_yaml(found) if isinstance(found, Policy) else circuit_to_yaml(found))


if __name__ == "__main__":
    app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)
    app.command()(convert)
    run_command_line(app, "paper.bnn")
