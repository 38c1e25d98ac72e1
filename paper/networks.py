"""Small neural networks in place of a circuit, many of them in lanes.

They have the inputs and outputs of a policy's circuit. An input is the sensor's value as a part of its
range, clamped to it; where the policy has an input layer, the raw input over its
range. An output reaches from the motors' minimum to their maximum and stays there.

mlp     tanh cells on the inputs, outputs linear in the cells
lstm    Hochreiter and Schmidhuber (1997) with forget gates (Gers et al., 2000), outputs linear in the cells

    lanes = allocate_networks(net_for(policy, NetKind.MLP), 16)
    start_network(lanes, 3, vector)                    # (P,), and the lane's state at 0
    tick_networks(lanes, observations, commands)       # (inputs, 16), (outputs, 16)
"""

from dataclasses import dataclass
from enum import StrEnum
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rover_ncp.circuit.circuit import BOUNDS, ParameterKind
from rover_ncp.circuit.policy import ParameterBlock, ParameterLayout, Policy
from rover_ncp.circuit.solver import exp2
from rover_ncp.kernels.jit import kernel
from sim.learn.engine.lane_runner import LaneRunner

FloatArray = NDArray[np.float64]

CELLS = 11
"""As many cells as the tap-withdrawal circuit has neurons (paper, section VI)."""
_TWO_LOG2_E = 2.8853900817779268
_SATURATED = 30.0
"""Beyond it tanh is 1 to the last bit."""


class NetKind(StrEnum):
    """The networks the paper compares with."""

    MLP = "mlp"
    LSTM = "lstm"


class NetProgram(NamedTuple):
    """The structure that all lanes share."""

    gates: int
    """Sums that a cell makes of its inputs: 1 in a perceptron; 4 in an LSTM: input, forget, cell, output."""
    cells: int
    center: FloatArray
    scale: FloatArray
    most: FloatArray
    """(inputs,) each: an input is (observation - center) / scale, between -most and most."""
    low: FloatArray
    high: FloatArray
    """(outputs,) each: an output is high * z for z > 0 and -low * z for z < 0, ending at z = ±1."""


class NetLanes(NamedTuple):
    """The arrays of L networks of one kind; one thread at a time."""

    program: NetProgram
    weight: FloatArray
    """(P, L)."""
    hidden: FloatArray
    cell: FloatArray
    """(cells, L) each: what the cells give; what an LSTM's remember."""
    sums: FloatArray
    inputs: FloatArray
    """(gates * cells, L) and (inputs, L): work."""


@dataclass(frozen=True, eq=False)
class Net:
    """A network of a kind, with the inputs and outputs of a policy.

    Its parameters (P,): for each gate and cell the weights of all inputs, in an LSTM those of all cells, and
    a bias; then for each output the weights of all cells and a bias. Bounds are those of a policy's layers.
    """

    kind: NetKind
    center: tuple[float, ...]
    scale: tuple[float, ...]
    most: tuple[float, ...]
    low: tuple[float, ...]
    high: tuple[float, ...]
    cells: int = CELLS

    @property
    def gates(self) -> int:
        """Sums that a cell makes of its inputs."""
        return 1 if self.kind is NetKind.MLP else 4

    @property
    def columns(self) -> int:
        """Weights of a sum: of the inputs, in an LSTM of the cells, and the bias."""
        return len(self.scale) + (self.cells if self.kind is NetKind.LSTM else 0) + 1

    def layout(self) -> ParameterLayout:
        """Return where the cells' weights and the outputs' stand in the parameter vector."""
        first = self.gates * self.cells * self.columns
        last = first + len(self.high) * (self.cells + 1)
        kinds = ((ParameterKind.INPUT_LAYER, 0, first), (ParameterKind.OUTPUT_LAYER, first, last))
        return ParameterLayout(
            tuple(ParameterBlock(kind, slice(a, b), *BOUNDS[kind][:2]) for kind, a, b in kinds)
        )

    def start(self, generator: np.random.Generator) -> FloatArray:
        """Draw the parameters (P,) of an untrained network: uniform within 1 / sqrt(inputs of the sum)."""
        layout = self.layout()
        vector = generator.uniform(-1.0, 1.0, layout.size)
        cells, outputs = layout.blocks
        vector[cells.slice] /= np.sqrt(self.columns - 1)
        vector[outputs.slice] /= np.sqrt(self.cells)
        return vector

    def program(self) -> NetProgram:
        """Return what the kernels take."""
        columns = (self.center, self.scale, self.most, self.low, self.high)
        return NetProgram(self.gates, self.cells, *(np.array(column, np.float64) for column in columns))


def net_for(policy: Policy, kind: NetKind, cells: int = CELLS) -> Net:
    """Return a network with the observation and the commands of a policy's circuit."""
    sensing, motors = policy.sensing, policy.motors
    if policy.input_layer is None:
        centers = [channel.origin or 0.0 for channel in sensing.channels]
        scales = [max(abs(end) for _, end in channel.sides) for channel in sensing.channels]
        most = [1.0 if sensing.clamp else np.inf] * len(scales)
    else:
        scales = list(sensing.ranges or [1.0] * len(sensing.inputs))
        centers, most = [0.0] * len(scales), [np.inf] * len(scales)
    if policy.output_layer is None:
        low = [channel.minimum or 0.0 for channel in motors.channels]
        high = [channel.maximum or 0.0 for channel in motors.channels]
    else:
        high = list(motors.limits or [1.0] * len(motors.outputs))
        low = [-end for end in high]
    return Net(kind, tuple(centers), tuple(scales), tuple(most), tuple(low), tuple(high), cells)


def allocate_networks(net: Net, count: int) -> NetLanes:
    """Return ``count`` lanes of zeros, to be set by ``start_network``."""
    sizes = (net.layout().size, net.cells, net.cells, net.gates * net.cells, len(net.scale))
    return NetLanes(net.program(), *(np.zeros((size, count)) for size in sizes))


@kernel
def start_network(lanes: NetLanes, lane: int, vector: FloatArray) -> None:
    """Set a lane's parameters (P,), and its state to 0."""
    for i in range(len(vector)):
        lanes.weight[i, lane] = vector[i]
    for cell in range(lanes.program.cells):
        lanes.hidden[cell, lane] = 0.0
        lanes.cell[cell, lane] = 0.0


@kernel
def tanh(z: float) -> float:
    """Return the hyperbolic tangent: the same bits on every machine."""
    result: float = 1.0 - 2.0 / (1.0 + exp2(_TWO_LOG2_E * min(max(z, -_SATURATED), _SATURATED)))
    return result


@kernel
def tick_networks(lanes: NetLanes, observations: FloatArray, commands: FloatArray) -> None:
    """Run L lanes once: ``observations`` (inputs, L) in the sensing's units, ``commands`` (outputs, L)."""
    scale_inputs(lanes, observations)
    tick_sums(lanes, commands)
    limit_outputs(lanes, commands)


@kernel
def scale_inputs(lanes: NetLanes, observations: FloatArray) -> None:
    """Set the inputs of L networks: observations (inputs, L) as parts of their ranges."""
    program = lanes.program
    given, count = observations.shape
    for i in range(given):
        center, scale, most = program.center[i], program.scale[i], program.most[i]
        for lane in range(count):
            part = (observations[i, lane] - center) / scale
            lanes.inputs[i, lane] = min(max(part, -most), most)


@kernel
def limit_outputs(lanes: NetLanes, commands: FloatArray) -> None:
    """Turn outputs (outputs, L), where ±1 is a limit, into commands."""
    program = lanes.program
    for output in range(len(program.high)):
        low, high = program.low[output], program.high[output]
        for lane in range(commands.shape[1]):
            z = min(max(commands[output, lane], -1.0), 1.0)
            commands[output, lane] = high * z if z > 0.0 else -low * z


@kernel
def tick_sums(lanes: NetLanes, commands: FloatArray) -> None:
    """Run L perceptrons or LSTMs once, from their inputs to outputs (outputs, L) without limits."""
    program = lanes.program
    weight, hidden, inputs, sums = lanes.weight, lanes.hidden, lanes.inputs, lanes.sums
    given, count = inputs.shape
    recurrent = program.cells if program.gates > 1 else 0
    at = 0
    for row in range(program.gates * program.cells):
        bias = at + given + recurrent
        for lane in range(count):
            sums[row, lane] = weight[bias, lane]
        for i in range(given):
            for lane in range(count):
                sums[row, lane] += weight[at + i, lane] * inputs[i, lane]
        for i in range(recurrent):
            for lane in range(count):
                sums[row, lane] += weight[at + given + i, lane] * hidden[i, lane]
        at = bias + 1
    update_cells(lanes, count)
    for output in range(len(program.high)):
        bias = at + program.cells
        for lane in range(count):
            z = weight[bias, lane]
            for cell in range(program.cells):
                z += weight[at + cell, lane] * hidden[cell, lane]
            commands[output, lane] = z
        at = bias + 1


@kernel
def update_cells(lanes: NetLanes, count: int) -> None:
    """Make the cells' new values of their sums."""
    hidden, cell, sums, cells = lanes.hidden, lanes.cell, lanes.sums, lanes.program.cells
    if lanes.program.gates == 1:
        for c in range(cells):
            for lane in range(count):
                hidden[c, lane] = tanh(sums[c, lane])
        return
    for c in range(cells):
        for lane in range(count):
            # A logistic gate is half a tanh of half its argument, plus a half.
            input_gate = 0.5 + 0.5 * tanh(0.5 * sums[c, lane])
            forget_gate = 0.5 + 0.5 * tanh(0.5 * sums[cells + c, lane])
            output_gate = 0.5 + 0.5 * tanh(0.5 * sums[3 * cells + c, lane])
            value = forget_gate * cell[c, lane] + input_gate * tanh(sums[2 * cells + c, lane])
            cell[c, lane] = value
            hidden[c, lane] = output_gate * tanh(value)


def network_lane_runner(net: Net) -> LaneRunner:
    """Return the runner of a network."""
    return LaneRunner(net.layout().size, partial(allocate_networks, net), start_network, tick_networks)
