"""A policy as C99: one function from an observation to a command, without allocation or libraries.

The statements are those of ``circuit/solver.py`` for one lane, in its order and with the numbers that a lane
holds, so that a build as double gives the solver's bits. Each neuron is written out: a wiring is short, and a
reader finds every neuron by its name.
"""

import re
from importlib import resources
from string import Template
from typing import Any

from rover_ncp.circuit import solver
from rover_ncp.circuit.circuit import MIDPOINT_MV, RESTING_MV, FloatArray
from rover_ncp.circuit.compiled import Synapses, allocate_lanes, make_program
from rover_ncp.circuit.policy import Policy

_FLOAT_DEGREE = 7
"""The next term of the exponential is below 6e-9 of it, a tenth of a float's last bit."""


def fill(template: str, **values: Any) -> str:
    """Return a template of this package with its places filled in."""
    text = (resources.files(__package__ or "") / "templates" / template).read_text()
    return Template(text).substitute(values)


def literal(value: float) -> str:
    """Return a number as C, exact as double; the macro R gives it the type."""
    return f"R({float(value)!r})"


def circuit_files(policy: Policy, name: str, version: str) -> dict[str, str]:
    """Return the files ``NAME.h`` and ``NAME.c`` of a policy; ``name`` is a C identifier."""
    common = {"name": name, "guard": name.upper(), "title": policy.circuit.name}
    header = fill(
        "circuit.h",
        version=version,
        tick_s=f"{policy.tick_s:g}",
        inputs=_words(policy.sensing.inputs),
        outputs=_words(policy.motors.outputs),
        input_count=len(policy.sensing.inputs),
        output_count=len(policy.motors.outputs),
        neuron_count=policy.circuit.size,
        neurons=", ".join(policy.circuit.neurons),
        **common,
    )
    return {f"{name}.h": header, f"{name}.c": _Writer(policy).source(common)}


def _words(names: tuple[str, ...]) -> str:
    """Return names for a comment, which none of them can end."""
    return ", ".join(re.sub(r"[^\w .+-]", "_", name) for name in names)


class _Writer:
    """The statements of one policy."""

    def __init__(self, policy: Policy) -> None:
        self._policy = policy
        self._program = make_program(policy)
        self._lane = allocate_lanes(self._program, policy, 1)
        self._names = policy.circuit.neurons

    def source(self, common: dict[str, str]) -> str:
        count = len(self._program.integrated.neuron)
        input_synapses, integrated = self._input_synapses(), self._integrated()
        chemical = "conductance(" in input_synapses + integrated
        arrays = f"    real current[{count}], total[{count}], next[{count}];\n" if count else ""
        return fill(
            "circuit.c",
            exponential=_exponential() if chemical else "",
            resting_mV=RESTING_MV,
            locals=f"{arrays}    real value, channel[{len(self._policy.motors.channels)}];",
            sensors=self._sensors(),
            input_synapses=input_synapses,
            integrated=integrated,
            motors=self._motors(),
            substeps=self._program.substeps,
            dt_s=f"{self._program.dt_s:g}",
            **common,
        )

    def _sensors(self) -> str:
        program, lines = self._program, []
        inputs, at = program.input_layer_at.shape[1], -1
        for s, neuron in enumerate(program.sensors.neuron):
            base, gain, lower, upper = (literal(column[s]) for column in program.sensors[2:])
            if at != program.sensors.channel[s]:  # of a pair, both neurons take the same value
                at = int(program.sensors.channel[s])
                lines.append("value = R(0.0);" if inputs else f"value = observation[{at}];")
                entries = self._lane.input_layer[0, at * inputs : (at + 1) * inputs, 0]
                lines += [f"value += {literal(x)} * observation[{i}];" for i, x in enumerate(entries)]
            set_to = f"smaller(larger({lower}, {base} + {gain} * value), {upper})"
            lines.append(f"V[{neuron}] = {set_to}; /* {self._names[neuron]} */")
        return _indented(lines, 4)

    def _input_synapses(self) -> str:
        lane, lines = self._lane, []
        for d, neuron in enumerate(self._program.integrated.neuron):
            current, total = f"current[{d}]", f"total[{d}]"
            lines += [
                f"/* {self._names[neuron]} */",
                f"{current} = {literal(lane.leak_current[0, d, 0])};",
                f"{total} = {literal(lane.conductance[0, d, 0])};",
                *_chemical(
                    self._program.input_synapses, (lane.input_weight, lane.input_slope), d, (current, total)
                ),
                *_gaps(self._program.input_gaps, lane.input_gap, d, current),
            ]
        return _indented(lines, 4)

    def _integrated(self) -> str:
        lane, lines = self._lane, []
        neurons = self._program.integrated.neuron
        numbers = lane.recurrent_weight, lane.recurrent_slope
        for d, neuron in enumerate(neurons):
            lines += [
                f"/* {self._names[neuron]} */",
                f"sum = current[{d}] + {literal(lane.rate[0, d, 0])} * V[{neuron}];",
                f"all = total[{d}];",
                *_chemical(self._program.recurrent_synapses, numbers, d, ("sum", "all")),
                *_gaps(self._program.recurrent_gaps, lane.recurrent_gap, d, "sum"),
                f"next[{d}] = sum / all;",
            ]
        if lines:
            lines.insert(0, "real sum, all;")
        lines += [f"V[{neuron}] = next[{d}];" for d, neuron in enumerate(neurons)]
        return _indented(lines, 8)

    def _motors(self) -> str:
        program, entries = self._program, self._lane.output_layer[0, :, 0]
        channels = len(self._policy.motors.channels)
        lines = [f"channel[{c}] = R(0.0);" for c in range(channels)]
        low, scale = literal(program.motor_low), literal(program.motor_scale)
        for neuron, channel, end in zip(*program.motors, strict=True):
            fraction = f"(V[{neuron}] - {low}) * {scale}"
            lines += [
                f"value = smaller(larger({fraction}, R(0.0)), R(1.0)); /* {self._names[neuron]} */",
                f"channel[{channel}] += {literal(end)} * value;",
            ]
        for o in range(len(self._policy.motors.outputs)):
            if not program.output_layer_at.size:
                lines.append(f"command[{o}] = channel[{o}];")
                continue
            lines.append("value = R(0.0);")
            lines += [
                f"value += {literal(entries[o * channels + c])} * channel[{c}];" for c in range(channels)
            ]
            if len(program.output_limit):
                limit = literal(program.output_limit[o])
                lines.append(f"command[{o}] = {limit} * smaller(larger(value, R(-1.0)), R(1.0));")
            else:
                lines.append(f"command[{o}] = value;")
        return _indented(lines, 4)


def _chemical(
    synapses: Synapses, numbers: tuple[FloatArray, FloatArray], neuron: int, sums: tuple[str, str]
) -> list[str]:
    """Return the statements that add a neuron's chemical synapses, excitatory ones first as in the solver.

    ``numbers`` are a lane's weights and slopes, ``sums`` the variables of current and conductance.
    """
    (weight, slope), (current, total), lines = numbers, sums, []
    for s in range(synapses.first[neuron], synapses.first[neuron + 1]):
        source = f"V[{synapses.source[s]}]"
        opened = f"conductance({literal(weight[0, s, 0])}, {literal(slope[0, s, 0])}, {source})"
        if s < synapses.first_inhibitory[neuron]:
            lines.append(f"{total} += {opened};")
        else:
            lines += [
                f"value = {opened};",
                f"{total} += value;",
                f"{current} += {literal(solver.INHIBITORY_MV)} * value;",
            ]
    return lines


def _gaps(gaps: Synapses, weight: FloatArray, neuron: int, current: str) -> list[str]:
    """Return the statements that add a neuron's gap junctions."""
    return [
        f"{current} += {literal(weight[0, s, 0])} * V[{gaps.source[s]}];"
        for s in range(gaps.first[neuron], gaps.first[neuron + 1])
    ]


def _exponential() -> str:
    """Return the solver's power of two and a synapse's conductance."""
    terms = [getattr(solver, f"_C{i}") for i in range(12)]
    # By Horner: as float it need not agree with another order of operations.
    float_polynomial = f"{terms[_FLOAT_DEGREE]!r}f * f + {terms[_FLOAT_DEGREE - 1]!r}f"
    for term in reversed(terms[: _FLOAT_DEGREE - 1]):
        float_polynomial = f"({float_polynomial}) * f + {term!r}f"
    return fill(
        "exponential.c",
        rounder=repr(solver._ROUNDER),
        float_rounder=repr(1.5 * 2.0**23),
        float_polynomial=float_polynomial,
        midpoint_mV=MIDPOINT_MV,
        **{f"c{i}": repr(term) for i, term in enumerate(terms)},
    )


def _indented(lines: list[str], by: int) -> str:
    return "\n".join(" " * by + line for line in lines)
