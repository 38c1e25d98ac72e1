"""From a policy to what the solver runs: its structure once, its numbers once per lane.

Many circuits of one wiring run side by side, each in a lane of its own:

    circuits = make_circuits(policy, 16)
    fill_lanes(circuits, vectors, first=3)                  # (k, P)
    tick = bound_tick(circuits, observations, commands)     # (inputs, 16), (outputs, 16)
    tick()
"""

from itertools import pairwise
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rover_ncp.circuit.circuit import RESTING_MV, Circuit, FloatArray, IntArray, ParameterKind, SynapseKind
from rover_ncp.circuit.motors import MotorMap
from rover_ncp.circuit.policy import ParameterLayout, Policy
from rover_ncp.circuit.sensing import SensorMap
from rover_ncp.native.core import WIDTH, Axes, aligned_zeros, fill_lanes

LOG2_E = 1.4426950408889634
MAX_LANES = 4096
"""Of one thread; more only fill the memory."""


class Integrated(NamedTuple):
    """The d neurons that the solver integrates, all but sensory and held ones. ``*_at``: indices in the
    parameter vector."""

    neuron: Annotated[IntArray, Axes("integrated", below="neurons")]
    leak_potential_at: Annotated[IntArray, Axes("integrated", below="parameters")]
    leak_at: Annotated[IntArray, Axes("integrated", below="parameters")]
    capacitance_at: Annotated[IntArray, Axes("integrated", below="parameters")]


class Synapses(NamedTuple):
    """Chemical synapses by destination, the inhibitory ones of a neuron last."""

    source: Annotated[IntArray, Axes(".synapses", below="neurons")]
    weight_at: Annotated[IntArray, Axes(".synapses", below="parameters")]
    sigma_at: Annotated[IntArray, Axes(".synapses", below="parameters")]
    first: Annotated[IntArray, Axes("integrated+1", below=".synapses+1")]
    """Where the synapses of each integrated neuron begin; the next entry is where they end."""
    first_inhibitory: Annotated[IntArray, Axes("integrated", below=".synapses+1")]
    """Where its inhibitory ones begin."""


class GapJunctions(NamedTuple):
    """Gap junctions by destination."""

    source: Annotated[IntArray, Axes(".junctions", below="neurons")]
    weight_at: Annotated[IntArray, Axes(".junctions", below="parameters")]
    first: Annotated[IntArray, Axes("integrated+1", below=".junctions+1")]


class Program(NamedTuple):
    """The structure that all lanes share.

    Input synapses come from sensory neurons, recurrent synapses from integrated neurons.
    """

    dt_s: float
    substeps: int
    sensors: SensorMap
    integrated: Integrated
    input_synapses: Synapses
    recurrent_synapses: Synapses
    input_gaps: GapJunctions
    recurrent_gaps: GapJunctions
    motors: MotorMap
    motor_low: float
    motor_scale: float
    """1 / (high - low) of the motors, 1/mV."""
    input_layer_at: Annotated[IntArray, Axes("channels?", "inputs?", below="parameters")]
    output_layer_at: Annotated[IntArray, Axes("outputs?", "motor_channels?", below="parameters")]
    """Indices in the parameter vector; without a layer of shape (0, 0)."""
    input_range: Annotated[FloatArray, Axes("inputs")]
    """What a layer's inputs are divided by."""
    output_limit: Annotated[FloatArray, Axes("outputs?")]
    """What a layer's outputs are parts of; of shape (0,) without limits."""


class LaneParameters(NamedTuple):
    """The numbers of all lanes, and work arrays: for one thread at a time.

    Lanes are in blocks of ``WIDTH``. The contents of spare lanes in the last block are not used.
    """

    input_weight: Annotated[FloatArray, Axes("blocks", "input_synapses.synapses", WIDTH)]
    input_slope: Annotated[FloatArray, Axes("blocks", "input_synapses.synapses", WIDTH)]
    recurrent_weight: Annotated[FloatArray, Axes("blocks", "recurrent_synapses.synapses", WIDTH)]
    recurrent_slope: Annotated[FloatArray, Axes("blocks", "recurrent_synapses.synapses", WIDTH)]
    """A slope is -sigma log2 e."""
    input_gap: Annotated[FloatArray, Axes("blocks", "input_gaps.junctions", WIDTH)]
    recurrent_gap: Annotated[FloatArray, Axes("blocks", "recurrent_gaps.junctions", WIDTH)]
    rate: Annotated[FloatArray, Axes("blocks", "integrated", WIDTH)]
    leak_current: Annotated[FloatArray, Axes("blocks", "integrated", WIDTH)]
    conductance: Annotated[FloatArray, Axes("blocks", "integrated", WIDTH)]
    """C / dt; G E_L; and C / dt + G + the sum of gap junctions."""
    input_layer: Annotated[FloatArray, Axes("blocks", "channels*inputs", WIDTH)]
    output_layer: Annotated[FloatArray, Axes("blocks", "outputs*motor_channels", WIDTH)]
    """The entries of the layers, row by row; none without a layer."""
    potential: Annotated[FloatArray, Axes(1, "neurons", WIDTH)]
    """mV, of the block at work."""
    current: Annotated[FloatArray, Axes(1, "integrated", WIDTH)]
    total: Annotated[FloatArray, Axes(1, "integrated", WIDTH)]
    """Current and conductance that are constant over a tick."""
    gate: Annotated[FloatArray, Axes(1, "recurrent_synapses.synapses", WIDTH)]
    gap_current: Annotated[FloatArray, Axes(1, "recurrent_gaps.junctions", WIDTH)]
    """What recurrent synapses conduct, and w V of gap junctions, in a substep."""
    channel: Annotated[FloatArray, Axes(1, "motor_channels", WIDTH)]


class Circuits(NamedTuple):
    """Circuits of one wiring, one in each lane."""

    program: Program
    parameters: LaneParameters
    potentials: Annotated[FloatArray, Axes("neurons", "lanes")]
    """mV."""


def make_program(policy: Policy) -> Program:
    """Return the structure of a policy, shared by all its lanes.

    Synapses into sensory neurons have no effect and are left out.
    """
    circuit, layout = policy.circuit, policy.layout()
    sensors = _with_held(policy.sensing.map_onto(circuit), circuit)
    integrated = np.setdiff1d(np.arange(circuit.size), sensors.neuron)
    live = np.isin(circuit.destination, integrated)
    from_sensory = np.isin(circuit.source, sensors.neuron)
    chemical = circuit.chemical

    def neurons_at(kind: ParameterKind) -> IntArray:
        at: IntArray = layout.block(kind).slice.start + integrated
        return at

    return Program(
        dt_s=policy.dt_s,
        substeps=policy.substeps,
        sensors=sensors,
        integrated=Integrated(
            neuron=integrated,
            leak_potential_at=neurons_at(ParameterKind.LEAK_POTENTIAL),
            leak_at=neurons_at(ParameterKind.LEAK),
            capacitance_at=neurons_at(ParameterKind.CAPACITANCE),
        ),
        input_synapses=_synapses(circuit, layout, integrated, live & chemical & from_sensory),
        recurrent_synapses=_synapses(circuit, layout, integrated, live & chemical & ~from_sensory),
        input_gaps=_gap_junctions(circuit, integrated, live & ~chemical & from_sensory),
        recurrent_gaps=_gap_junctions(circuit, integrated, live & ~chemical & ~from_sensory),
        motors=policy.motors.map_from(circuit),
        motor_low=policy.motors.low_mV,
        motor_scale=1.0 / (policy.motors.high_mV - policy.motors.low_mV),
        input_layer_at=_layer_at(policy, layout, ParameterKind.INPUT_LAYER),
        output_layer_at=_layer_at(policy, layout, ParameterKind.OUTPUT_LAYER),
        input_range=np.array(policy.sensing.ranges or np.ones(len(policy.sensing.inputs)), np.float64),
        output_limit=np.array(policy.motors.limits or (), np.float64),
    )


def dead_parameters(policy: Policy) -> NDArray[np.bool_]:
    """Return which parameters (P,) have no effect on the outputs: those of sensory neurons, mostly."""
    program = make_program(policy)
    chemical = program.input_synapses, program.recurrent_synapses
    read = [
        *program.integrated[1:],
        *(places for synapses in chemical for places in (synapses.weight_at, synapses.sigma_at)),
        program.input_gaps.weight_at,
        program.recurrent_gaps.weight_at,
        program.input_layer_at.ravel(),
        program.output_layer_at.ravel(),
    ]
    dead = np.ones(policy.layout().size, bool)
    dead[np.concatenate(read)] = False
    return dead


def make_circuits(policy: Policy, count: int) -> Circuits:
    """Return circuits in so many lanes with the policy's parameters, at rest; ``fill_lanes`` sets others.

    The last block's spare lanes keep the policy's, so that they compute only numbers. Raises ValueError for
    less than one lane, UsageError without the native library.
    """
    if not 1 <= count <= MAX_LANES:
        raise ValueError(f"{count} lanes, expected 1 to {MAX_LANES}")
    program = make_program(policy)
    blocks, integrated = -(-count // WIDTH), len(program.integrated.neuron)

    def rows(number: int, blocks: int = blocks) -> FloatArray:
        return aligned_zeros(blocks, number, WIDTH)

    parameters = LaneParameters(
        input_weight=rows(len(program.input_synapses.source)),
        input_slope=rows(len(program.input_synapses.source)),
        recurrent_weight=rows(len(program.recurrent_synapses.source)),
        recurrent_slope=rows(len(program.recurrent_synapses.source)),
        input_gap=rows(len(program.input_gaps.source)),
        recurrent_gap=rows(len(program.recurrent_gaps.source)),
        rate=rows(integrated),
        leak_current=rows(integrated),
        conductance=rows(integrated),
        input_layer=rows(program.input_layer_at.size),
        output_layer=rows(program.output_layer_at.size),
        potential=rows(policy.circuit.size, 1),
        current=rows(integrated, 1),
        total=rows(integrated, 1),
        gate=rows(len(program.recurrent_synapses.source), 1),
        gap_current=rows(len(program.recurrent_gaps.source), 1),
        channel=rows(len(policy.motors.channels), 1),
    )
    potentials = aligned_zeros(policy.circuit.size, count)
    potentials[:] = RESTING_MV
    circuits = Circuits(program, parameters, potentials)
    fill_lanes(circuits, np.tile(policy.parameters(), (blocks * WIDTH, 1)))
    return circuits


def _with_held(sensors: SensorMap, circuit: Circuit) -> SensorMap:
    """Return the sensors with the held neurons added: constant, whatever is observed."""
    held = [i for i in sorted(circuit.held) if i not in sensors.neuron]
    held_mV = np.array([circuit.held[i] for i in held], np.float64)
    zeros = np.zeros(len(held))
    added = SensorMap(np.array(held, np.int64), zeros.astype(np.int64), zeros, zeros, held_mV, held_mV)
    return SensorMap._make(np.concatenate(pair) for pair in zip(sensors, added, strict=True))


def _synapses(
    circuit: Circuit, layout: ParameterLayout, integrated: IntArray, chosen: NDArray[np.bool_]
) -> Synapses:
    synapses = np.flatnonzero(chosen)
    inhibitory = circuit.kind[synapses] == SynapseKind.INHIBITORY
    order = np.lexsort((inhibitory, circuit.destination[synapses]))
    synapses, inhibitory = synapses[order], inhibitory[order]
    first = _first(circuit, integrated, synapses)
    others = [np.count_nonzero(~inhibitory[a:b]) for a, b in pairwise(first)]
    sigma_at = np.cumsum(circuit.chemical)[synapses] - 1
    if len(synapses):
        sigma_at += layout.block(ParameterKind.SIGMA).slice.start
    return Synapses(
        source=circuit.source[synapses],
        weight_at=synapses,
        sigma_at=sigma_at,
        first=first,
        first_inhibitory=first[:-1] + np.array(others, np.int64),
    )


def _gap_junctions(circuit: Circuit, integrated: IntArray, chosen: NDArray[np.bool_]) -> GapJunctions:
    junctions = np.flatnonzero(chosen)
    junctions = junctions[np.argsort(circuit.destination[junctions], kind="stable")]
    return GapJunctions(
        source=circuit.source[junctions], weight_at=junctions, first=_first(circuit, integrated, junctions)
    )


def _first(circuit: Circuit, integrated: IntArray, synapses: IntArray) -> IntArray:
    """Return where synapses in the order of their destinations begin for each integrated neuron, and end."""
    begin = np.searchsorted(circuit.destination[synapses], integrated)
    return np.append(begin, len(synapses)).astype(np.int64)


def _layer_at(policy: Policy, layout: ParameterLayout, kind: ParameterKind) -> IntArray:
    layer = getattr(policy, kind)
    if layer is None:
        return np.zeros((0, 0), np.int64)
    block = layout.block(kind)
    return np.arange(block.slice.start, block.slice.stop).reshape(layer.shape)
