"""From a policy to what the solver runs: its structure once, its numbers once per lane.

A user of many lanes makes the program, allocates lanes for the most it will ever run together, sets them
to parameter vectors and ticks them, all of it from Python or from a kernel of its own:

    program = make_program(policy)
    lanes = allocate_lanes(program, policy, 16)
    fill_lane(program, lanes, 3, vector)                              # (P,)
    potentials = resting_potentials(policy, 16)                       # (n, 16)
    tick_lanes(program, lanes, potentials, observations, commands)    # (inputs, 16), (outputs, 16)
"""

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rover_ncp.circuit.circuit import RESTING_MV, Circuit, FloatArray, IntArray, ParameterKind, SynapseKind
from rover_ncp.circuit.motors import MotorMap
from rover_ncp.circuit.policy import ParameterLayout, Policy
from rover_ncp.circuit.sensing import SensorMap
from rover_ncp.kernels.jit import kernel
from rover_ncp.kernels.vectors import WIDTH, RowArray, aligned_zeros

LOG2_E = 1.4426950408889634


class Integrated(NamedTuple):
    """The d neurons that the solver integrates, all but sensory and held ones. ``*_at``: indices in the
    parameter vector."""

    neuron: IntArray
    leak_potential_at: IntArray
    leak_at: IntArray
    capacitance_at: IntArray


class Synapses(NamedTuple):
    """Chemical synapses or gap junctions by destination, the inhibitory ones of a neuron last."""

    source: IntArray
    weight_at: IntArray
    sigma_at: IntArray
    """Of chemical ones; (0,) for gap junctions."""
    first: RowArray
    """(d + 1,) where the synapses of each integrated neuron begin; the next entry is where they end."""
    first_inhibitory: RowArray
    """(d,) where its inhibitory ones begin."""


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
    input_gaps: Synapses
    recurrent_gaps: Synapses
    motors: MotorMap
    motor_low: float
    motor_scale: float
    """1 / (high - low) of the motors, 1/mV."""
    input_layer_at: IntArray
    output_layer_at: IntArray
    """(channels, inputs) and (outputs, channels): indices in the vector; without a layer of shape (0, 0)."""
    input_range: FloatArray
    """(inputs,) what a layer's inputs are divided by."""
    output_limit: FloatArray
    """(outputs,) what a layer's outputs are parts of; of shape (0,) without limits."""


class LaneParameters(NamedTuple):
    """The numbers of all lanes, and work arrays: for one thread at a time.

    B blocks of WIDTH lanes. The contents of spare lanes in the last block are not used.
    """

    input_weight: FloatArray
    input_slope: FloatArray
    recurrent_weight: FloatArray
    recurrent_slope: FloatArray
    """(B, synapses, WIDTH) each; a slope is -sigma log2 e."""
    input_gap: FloatArray
    recurrent_gap: FloatArray
    """(B, junctions, WIDTH) each."""
    rate: FloatArray
    leak_current: FloatArray
    conductance: FloatArray
    """(B, d, WIDTH) each: C / dt; G E_L; and C / dt + G + the sum of gap junctions."""
    input_layer: FloatArray
    output_layer: FloatArray
    """(B, channels * inputs, WIDTH) and (B, outputs * channels, WIDTH)."""
    potential: FloatArray
    """(1, n, WIDTH) the block at work, mV."""
    current: FloatArray
    total: FloatArray
    next_potential: FloatArray
    """(1, d, WIDTH) each: current and conductance that are constant over a tick, and the next potentials."""
    divisor: FloatArray
    """(1, recurrent synapses, WIDTH) what their weights are divided by."""
    channel: FloatArray
    """(1, sensory or motor channels, WIDTH)."""


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
        input_gaps=_synapses(circuit, layout, integrated, live & ~chemical & from_sensory),
        recurrent_gaps=_synapses(circuit, layout, integrated, live & ~chemical & ~from_sensory),
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
    groups = program.input_synapses, program.recurrent_synapses, program.input_gaps, program.recurrent_gaps
    read = [
        *program.integrated[1:],
        *(places for synapses in groups for places in (synapses.weight_at, synapses.sigma_at)),
        program.input_layer_at.ravel(),
        program.output_layer_at.ravel(),
    ]
    dead = np.ones(policy.layout().size, bool)
    dead[np.concatenate(read)] = False
    return dead


def allocate_lanes(program: Program, policy: Policy, count: int) -> LaneParameters:
    """Return ``count`` lanes with the policy's own parameters, to be set to others by ``fill_lane``.

    The last block's spare lanes keep the policy's, so that they compute nothing but numbers.
    """
    blocks, count_integrated = -(-count // WIDTH), len(program.integrated.neuron)

    def rows(number: int, blocks: int = blocks) -> FloatArray:
        return aligned_zeros(blocks, number, WIDTH)

    lanes = LaneParameters(
        input_weight=rows(len(program.input_synapses.source)),
        input_slope=rows(len(program.input_synapses.source)),
        recurrent_weight=rows(len(program.recurrent_synapses.source)),
        recurrent_slope=rows(len(program.recurrent_synapses.source)),
        input_gap=rows(len(program.input_gaps.source)),
        recurrent_gap=rows(len(program.recurrent_gaps.source)),
        rate=rows(count_integrated),
        leak_current=rows(count_integrated),
        conductance=rows(count_integrated),
        input_layer=rows(program.input_layer_at.size),
        output_layer=rows(program.output_layer_at.size),
        potential=rows(policy.circuit.size, 1),
        current=rows(count_integrated, 1),
        total=rows(count_integrated, 1),
        next_potential=rows(count_integrated, 1),
        divisor=rows(len(program.recurrent_synapses.source), 1),
        channel=rows(len(policy.motors.channels), 1),
    )
    vector = policy.parameters()
    for lane in range(blocks * WIDTH):
        fill_lane(program, lanes, lane, vector)
    return lanes


def resting_potentials(policy: Policy, count: int) -> FloatArray:
    """Return the potentials (n, count) in mV at the start of a run."""
    potentials = aligned_zeros(policy.circuit.size, count)
    potentials[:] = RESTING_MV
    return potentials


@kernel
def fill_lane(program: Program, lanes: LaneParameters, lane: int, vector: FloatArray) -> None:
    """Set the numbers of one lane from a parameter vector (P,), which must lie in bounds."""
    block, place = lane // WIDTH, lane % WIDTH
    fill_synapses(program.input_synapses, lanes.input_weight, lanes.input_slope, vector, lane)
    fill_synapses(program.recurrent_synapses, lanes.recurrent_weight, lanes.recurrent_slope, vector, lane)
    neurons, leak_potential_at, leak_at, capacitance_at = program.integrated
    rates, leak_currents, conductances = lanes.rate, lanes.leak_current, lanes.conductance
    for d in range(len(neurons)):
        rate = vector[capacitance_at[d]] / program.dt_s
        leak = vector[leak_at[d]]
        rates[block, d, place] = rate
        leak_currents[block, d, place] = leak * vector[leak_potential_at[d]]
        conductances[block, d, place] = rate + leak
    fill_gaps(program.input_gaps, lanes.input_gap, lanes.conductance, vector, lane)
    fill_gaps(program.recurrent_gaps, lanes.recurrent_gap, lanes.conductance, vector, lane)
    ranges = program.input_range
    for i, at in enumerate(program.input_layer_at.flat):
        lanes.input_layer[block, i, place] = vector[at] / ranges[i % len(ranges)]
    for i, at in enumerate(program.output_layer_at.flat):
        lanes.output_layer[block, i, place] = vector[at]


@kernel
def fill_synapses(
    synapses: Synapses, weight: FloatArray, slope: FloatArray, vector: FloatArray, lane: int
) -> None:
    """Set one lane's chemical synapses."""
    block, place = lane // WIDTH, lane % WIDTH
    weight_at, sigma_at = synapses.weight_at, synapses.sigma_at
    for s in range(len(weight_at)):
        weight[block, s, place] = vector[weight_at[s]]
        slope[block, s, place] = -LOG2_E * vector[sigma_at[s]]


@kernel
def fill_gaps(gaps: Synapses, weight: FloatArray, total: FloatArray, vector: FloatArray, lane: int) -> None:
    """Set one lane's gap junctions, and add them to the conductances of their destinations."""
    block, place = lane // WIDTH, lane % WIDTH
    first, weight_at = gaps.first, gaps.weight_at
    for d in range(len(first) - 1):
        for s in range(first[d], first[d + 1]):
            weight[block, s, place] = vector[weight_at[s]]
            total[block, d, place] += vector[weight_at[s]]


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
    begin = np.searchsorted(circuit.destination[synapses], integrated)
    first = np.append(begin, len(synapses)).astype(np.uint64)
    others = [np.count_nonzero(~inhibitory[a:b]) for a, b in pairwise(first)]
    chemical = synapses[circuit.chemical[synapses]]
    sigma_at = np.cumsum(circuit.chemical)[chemical] - 1
    if len(chemical):
        sigma_at += layout.block(ParameterKind.SIGMA).slice.start
    return Synapses(
        source=circuit.source[synapses],
        weight_at=synapses,
        sigma_at=sigma_at,
        first=first,
        first_inhibitory=first[:-1] + np.array(others, np.uint64),
    )


def _layer_at(policy: Policy, layout: ParameterLayout, kind: ParameterKind) -> IntArray:
    layer = getattr(policy, kind)
    if layer is None:
        return np.zeros((0, 0), np.int64)
    block = layout.block(kind)
    return np.arange(block.slice.start, block.slice.stop).reshape(layer.shape)
