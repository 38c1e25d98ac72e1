"""LTC and CfC as the library ncps has them, in lanes: what a cell computes, and what it is made of.

ltc     liquid time-constant cells (Hasani et al., 2021), fully connected, six steps of the fused solver; the
        first cells are the motors
cfc     closed-form continuous-time cells (Hasani et al., 2022) behind a backbone of four units, with a gate;
        outputs linear in the cells

Weights keep the library's names, so a parameter vector is one of its modules and the other way round. The
tests hold the kernels to the library's own output.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rover_ncp.circuit.circuit import ParameterKind
from rover_ncp.circuit.compiled import LOG2_E
from rover_ncp.circuit.policy import ParameterBlock, ParameterLayout, Policy
from rover_ncp.circuit.solver import exp2
from rover_ncp.kernels.jit import kernel
from sim.learn.engine.lane_runner import LaneRunner
from sim.learn.engine.networks import (
    Net,
    NetKind,
    NetLanes,
    limit_outputs,
    net_for,
    scale_inputs,
    start_network,
)

FloatArray = NDArray[np.float64]

CELLS = 3
BACKBONE = 4
"""Units of a CfC's backbone: with three cells about as many numbers as the circuit has."""
UNFOLDS = 6
"""Steps of an LTC's solver in a tick; the library's default."""
_EPSILON = 1e-8
"""Keeps the library's solver from a division by zero."""
_SATURATED = 500.0


class Tensor(NamedTuple):
    """One of a module's arrays: its name in the library, its shape, and the ends of its start's range."""

    name: str
    shape: tuple[int, ...]
    low: float
    high: float

    @property
    def size(self) -> int:
        """How many numbers it holds."""
        return math.prod(self.shape)

    def start(self, generator: np.random.Generator) -> FloatArray:
        """Draw its numbers (size,) as the library does: uniform; two of three reversals are 1, one is -1."""
        drawn = generator.uniform(self.low, self.high, self.size)
        return np.sign(drawn) if self.name.endswith("erev") else drawn


class Part(NamedTuple):
    """Tensors that stand together in the vector, and what a search may make of them. Bounds are ours."""

    kind: ParameterKind
    lower: float
    upper: float
    tensors: tuple[Tensor, ...]


def ltc_parts(inputs: int, cells: int, outputs: int) -> tuple[Part, ...]:
    """Return the parts of an LTC."""

    def synapses(name: str, low: float, high: float) -> tuple[Tensor, ...]:
        ends = (("", cells), ("sensory_", inputs))
        return tuple(Tensor(f"rnn_cell.{given}{name}", (rows, cells), low, high) for given, rows in ends)

    def each(name: str, count: int, low: float, high: float) -> Tensor:
        return Tensor(f"rnn_cell.{name}", (count,), low, high)

    layer, motors = ParameterKind.INPUT_LAYER, ParameterKind.OUTPUT_LAYER
    return (
        Part(ParameterKind.WEIGHT, 0.0, 3.0, synapses("w", 0.001, 1.0)),
        Part(layer, 0.0, 10.0, synapses("sigma", 3.0, 8.0)),
        Part(layer, -3.0, 3.0, synapses("mu", 0.3, 0.8)),
        Part(layer, -3.0, 3.0, synapses("erev", -1.0, 2.0)),
        Part(layer, -3.0, 3.0, (each("vleak", cells, -0.2, 0.2),)),
        Part(ParameterKind.LEAK, 0.001, 5.0, (each("gleak", cells, 0.001, 1.0),)),
        Part(ParameterKind.CAPACITANCE, 0.01, 5.0, (each("cm", cells, 0.4, 0.6),)),
        Part(layer, -3.0, 3.0, (each("input_w", inputs, 1.0, 1.0), each("input_b", inputs, 0.0, 0.0))),
        Part(motors, -3.0, 3.0, (each("output_w", outputs, 1.0, 1.0), each("output_b", outputs, 0.0, 0.0))),
    )


def cfc_parts(inputs: int, cells: int, outputs: int) -> tuple[Part, ...]:
    """Return the parts of a CfC."""

    def linear(name: str, columns: int, rows: int, most: float | None = None) -> tuple[Tensor, Tensor]:
        end = 1.0 / math.sqrt(columns)
        glorot = most if most is not None else math.sqrt(6.0 / (columns + rows))
        weight = Tensor(f"{name}.weight", (rows, columns), -glorot, glorot)
        return weight, Tensor(f"{name}.bias", (rows,), -end, end)

    heads = (linear(f"rnn_cell.{name}", BACKBONE, cells) for name in ("ff1", "ff2", "time_a", "time_b"))
    backbone = linear("rnn_cell.backbone.0", inputs + cells, BACKBONE)
    cell = (*backbone, *(tensor for head in heads for tensor in head))
    return (
        Part(ParameterKind.INPUT_LAYER, -3.0, 3.0, cell),
        Part(ParameterKind.OUTPUT_LAYER, -3.0, 3.0, linear("fc", cells, outputs, 1.0 / math.sqrt(cells))),
    )


PARTS: dict[str, Callable[[int, int, int], tuple[Part, ...]]] = {"cfc": cfc_parts, "ltc": ltc_parts}


@dataclass(frozen=True, eq=False)
class LiquidNet:
    """A network of a kind, ``cfc`` or ``ltc``, with the inputs, outputs and number of cells of another."""

    kind: str
    like: Net

    @property
    def parts(self) -> tuple[Part, ...]:
        """The library's tensors, in the order of the vector."""
        return PARTS[self.kind](len(self.like.scale), self.like.cells, len(self.like.high))

    def layout(self) -> ParameterLayout:
        """Return where the parts stand in the parameter vector."""
        ends = np.cumsum([0, *(sum(tensor.size for tensor in part.tensors) for part in self.parts)])
        blocks = (
            ParameterBlock(part.kind, slice(int(a), int(b)), part.lower, part.upper)
            for part, (a, b) in zip(self.parts, pairwise(ends), strict=True)
        )
        return ParameterLayout(tuple(blocks))

    def start(self, generator: np.random.Generator) -> FloatArray:
        """Draw the parameters (P,) of an untrained network as the library does."""
        return np.concatenate([tensor.start(generator) for part in self.parts for tensor in part.tensors])


def liquid_net_for(policy: Policy, kind: str) -> LiquidNet:
    """Return a network with the observation and the commands of a policy's circuit."""
    return LiquidNet(kind, net_for(policy, NetKind.LSTM, CELLS))


def allocate(net: LiquidNet, count: int) -> NetLanes:
    """Return ``count`` lanes of zeros; their sums are the work of ``tick_ltc`` and ``tick_cfc``."""
    cells = net.like.cells
    sizes = (net.layout().size, cells, cells, 4 * cells + BACKBONE, len(net.like.scale))
    return NetLanes(net.like.program(), *(np.zeros((size, count)) for size in sizes))


@kernel
def tick_cfc_lanes(lanes: NetLanes, observations: FloatArray, commands: FloatArray) -> None:
    """Run L CfC once: ``observations`` (inputs, L) in the sensing's units, ``commands`` (outputs, L)."""
    scale_inputs(lanes, observations)
    tick_cfc(lanes.weight, lanes.inputs, lanes.hidden, lanes.sums, commands[: len(lanes.program.high)])
    limit_outputs(lanes, commands)


@kernel
def tick_ltc_lanes(lanes: NetLanes, observations: FloatArray, commands: FloatArray) -> None:
    """Run L LTC once; arguments as ``tick_cfc_lanes``."""
    scale_inputs(lanes, observations)
    tick_ltc(lanes.weight, lanes.inputs, lanes.hidden, lanes.sums, commands[: len(lanes.program.high)])
    limit_outputs(lanes, commands)


@kernel
def sigmoid(z: float) -> float:
    """Return the logistic function: the same bits on every machine."""
    result: float = 1.0 / (1.0 + exp2(-LOG2_E * min(max(z, -_SATURATED), _SATURATED)))
    return result


@kernel
def tick_ltc(
    weight: FloatArray, inputs: FloatArray, hidden: FloatArray, work: FloatArray, commands: FloatArray
) -> None:
    """Run L cells of LTC once.

    ``weight`` (P, L), ``inputs`` (inputs, L), which are overwritten, ``hidden`` (cells, L), advanced in
    place, ``work`` (4 * cells, L), ``commands`` (outputs, L), written.
    """
    given, cells, outputs = len(inputs), len(hidden), len(commands)
    synapses = (given + cells) * cells
    rest = 4 * synapses
    leak, capacity, at = rest + cells, rest + 2 * cells, rest + 3 * cells
    inputs[:] = inputs * weight[at : at + given] + weight[at + given : at + 2 * given]
    from_inputs, sums = work[: 2 * cells], work[2 * cells : 4 * cells]
    for d in range(cells):
        from_inputs[2 * d] = weight[leak + d] * weight[rest + d]
        from_inputs[2 * d + 1] = weight[leak + d] + _EPSILON
        for i in range(given):
            add_synapse(weight, synapses, (cells + i) * cells + d, inputs[i], from_inputs[2 * d : 2 * d + 2])
    for _ in range(UNFOLDS):
        for d in range(cells):
            rate = UNFOLDS * weight[capacity + d]
            sums[2 * d] = from_inputs[2 * d] + rate * hidden[d]
            sums[2 * d + 1] = from_inputs[2 * d + 1] + rate
            for s in range(cells):
                add_synapse(weight, synapses, s * cells + d, hidden[s], sums[2 * d : 2 * d + 2])
        for d in range(cells):
            hidden[d] = sums[2 * d] / sums[2 * d + 1]
    at += 2 * given
    commands[:] = hidden[:outputs] * weight[at : at + outputs] + weight[at + outputs : at + 2 * outputs]


@kernel
def add_synapse(weight: FloatArray, synapses: int, at: int, source: FloatArray, sums: FloatArray) -> None:
    """Add synapse ``at`` of so many from values (L,) to its cell's sums: current and conductance (2, L)."""
    for lane in range(len(source)):
        steepness, middle = weight[synapses + at, lane], weight[2 * synapses + at, lane]
        opened = weight[at, lane] * sigmoid(steepness * (source[lane] - middle))
        sums[0, lane] += opened * weight[3 * synapses + at, lane]
        sums[1, lane] += opened


@kernel
def dense(weight: FloatArray, at: int, given: FloatArray, result: FloatArray) -> int:
    """Write W x + b of x (columns, L) into (rows, L); W and b begin at ``at`` in (P, L). Return their end."""
    columns, rows = len(given), len(result)
    for row in range(rows):
        for lane in range(given.shape[1]):
            result[row, lane] = weight[at + rows * columns + row, lane]
        for i in range(columns):
            for lane in range(given.shape[1]):
                result[row, lane] += weight[at + row * columns + i, lane] * given[i, lane]
    return at + rows * (columns + 1)


@kernel
def tick_cfc(
    weight: FloatArray, inputs: FloatArray, hidden: FloatArray, work: FloatArray, commands: FloatArray
) -> None:
    """Run L cells of CfC once; arguments as ``tick_ltc``, ``work`` (4 * cells + BACKBONE, L)."""
    cells = len(hidden)
    heads, backbone = work[: 4 * cells], work[4 * cells :]
    at = dense(weight, 0, np.concatenate((inputs, hidden)), backbone)
    squash(backbone, 0.666)
    backbone *= 1.7159
    for head in range(4):
        at = dense(weight, at, backbone, heads[head * cells : (head + 1) * cells])
    squash(heads[: 2 * cells], 1.0)
    for c in range(cells):
        for lane in range(inputs.shape[1]):
            share = sigmoid(heads[2 * cells + c, lane] + heads[3 * cells + c, lane])
            hidden[c, lane] = heads[c, lane] * (1.0 - share) + share * heads[cells + c, lane]
    dense(weight, at, hidden, commands)


@kernel
def squash(values: FloatArray, slope: float) -> None:
    """Replace values (rows, L) by the hyperbolic tangent of a multiple."""
    for row in range(values.shape[0]):
        for lane in range(values.shape[1]):
            values[row, lane] = 2.0 * sigmoid(2.0 * slope * values[row, lane]) - 1.0


def liquid_lane_runner(net: LiquidNet) -> LaneRunner:
    """Return the runner of a network."""
    tick = tick_cfc_lanes if net.kind == "cfc" else tick_ltc_lanes
    return LaneRunner(net.layout().size, partial(allocate, net), start_network, tick)
