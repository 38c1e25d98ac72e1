"""The circuit's solver: many circuits of one wiring, one lane each, stepped together.

This is the kernel that everything runs: training with many lanes, the rover with one. It computes what
``solver_reference.py`` defines, with the same result to the last bit whatever the number of lanes and the
place of a lane among them: each lane sees the same operations in the same order, and the exponential is our
own, so neither a library's version nor a machine's vector width shows in a trajectory.

The structure (``Program``) is shared by all lanes; numbers (``LaneParameters``) are arrays with a row per
synapse or neuron and a column per lane, so that the inner loops run over lanes and compile to vector code.
Sensory neurons are set, never stepped, and constant over a tick: what they do to others is summed up once.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rover_ncp.circuit.circuit import MIDPOINT_MV
from rover_ncp.circuit.sensing import LOW_MV
from rover_ncp.jit import kernel

__all__ = ["LaneParameters", "Program", "copy_lane", "exp2", "tick_lanes"]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

LOG2_E = 1.4426950408889634
INHIBITORY_MV = -90.0  # circuit.REVERSAL_MV; the excitatory reversal potential is 0 and drops out

# 2**f on [-1/2, 1/2], interpolated at Chebyshev nodes in 60 digits: relative error below 5e-18.
_C0, _C1, _C2 = 1.0, 0.6931471805599453, 0.24022650695910158
_C3, _C4, _C5 = 0.055504108664821625, 0.009618129107587256, 0.001333355814640647
_C6, _C7, _C8 = 0.00015403530463724353, 1.5252733841556773e-05, 1.3215432535912375e-06
_C9, _C10, _C11 = 1.0178057087733941e-07, 7.074194297288521e-09, 4.4558179083360645e-10
# Adding it rounds a number below 2**51 to an integer, which then stands in the sum's lowest bits.
_ROUNDER = 1.5 * 2.0**52


class Program(NamedTuple):
    """The structure that all lanes share. A slot is the place of a stepped neuron in ``stepped``."""

    substeps: int
    driven: IntArray
    """(s,) neurons that are set: sensory ones and those held constant."""
    drive_channel: IntArray
    drive_gain: FloatArray
    drive_lower: FloatArray
    drive_upper: FloatArray
    """(s,) each: potential = clip(LOW_MV + gain * channel, lower, upper)."""
    stepped: IntArray
    """(d,) all other neurons."""
    settled_source: IntArray
    settled_slot: IntArray
    settled_inhibitory: NDArray[np.bool_]
    """(p,) each: chemical synapses from driven neurons."""
    active_source: IntArray
    active_slot: IntArray
    excitatory_count: int
    """(a,) each: chemical synapses between stepped neurons, the excitatory ones first."""
    settled_gap_source: IntArray
    settled_gap_slot: IntArray
    """(b,) each: gap junctions from driven neurons."""
    gap_source: IntArray
    gap_slot: IntArray
    """(g,) each: gap junctions between stepped neurons."""
    motor_neuron: IntArray
    motor_channel: IntArray
    motor_end: FloatArray
    """(q,) each: channel += end * clip((potential - motor_low) * motor_scale, 0, 1)."""
    motor_low: float
    motor_scale: float


class LaneParameters(NamedTuple):
    """The numbers of L lanes, one column each, and room to work in (so: one thread at a time)."""

    settled_weight: FloatArray
    settled_slope: FloatArray
    active_weight: FloatArray
    active_slope: FloatArray
    """(p, L) and (a, L): maximum conductance, and -sigma log2 e."""
    settled_gap: FloatArray
    gap: FloatArray
    """(b, L) and (g, L)."""
    rate: FloatArray
    leak_current: FloatArray
    conductance: FloatArray
    """(d, L): C / dt; G E_L; and C / dt + G + the sum of gap junctions."""
    input_layer: FloatArray
    output_layer: FloatArray
    """(channels, inputs, L) and (outputs, channels, L); with no rows where there is no layer."""
    gate: FloatArray
    """(a, L) work."""
    base_current: FloatArray
    base_conductance: FloatArray
    current: FloatArray
    total: FloatArray
    """(d, L) work."""
    motor: FloatArray
    """(motor channels, L) work."""


@kernel
def exp2(z: float) -> float:
    """Return 2**z within 2 ulp for -1000 <= z <= 1000; outside, or for NaN, the result means nothing."""
    shifted = z + _ROUNDER
    f = z - (shifted - _ROUNDER)
    # Estrin's scheme: short chains of dependent operations, so that a processor overlaps them.
    f2 = f * f
    f4 = f2 * f2
    low = (_C0 + _C1 * f) + (_C2 + _C3 * f) * f2
    middle = (_C4 + _C5 * f) + (_C6 + _C7 * f) * f2
    high = (_C8 + _C9 * f) + (_C10 + _C11 * f) * f2
    mantissa = np.float64(low + (middle + high * f4) * f4)
    exponent = np.float64(shifted).view(np.int64) << 52
    return np.int64(mantissa.view(np.int64) + exponent).view(np.float64)


@kernel
def tick_lanes(
    program: Program,
    lanes: LaneParameters,
    potentials: FloatArray,
    observations: FloatArray,
    commands: FloatArray,
) -> None:
    """Run one control tick of every lane.

    ``potentials`` (n, L) in mV is advanced in place, ``observations`` (inputs, L) are read in the units of
    the sensing, ``commands`` (outputs, L) are written in those of the motors. Observations must be finite.
    """
    set_sensory_neurons(program, lanes, potentials, observations)
    sum_settled_synapses(program, lanes, potentials)
    for _ in range(program.substeps):
        step(program, lanes, potentials)
    read_motors(program, lanes, potentials, commands)


@kernel
def set_sensory_neurons(
    program: Program, lanes: LaneParameters, potentials: FloatArray, observations: FloatArray
) -> None:
    """Set the driven neurons of all lanes from their observations."""
    layer = lanes.input_layer
    for s in range(len(program.driven)):
        neuron, channel = program.driven[s], program.drive_channel[s]
        gain, lower, upper = program.drive_gain[s], program.drive_lower[s], program.drive_upper[s]
        for lane in range(potentials.shape[1]):
            if layer.shape[0] == 0:
                value = observations[channel, lane]
            else:
                value = 0.0
                for i in range(layer.shape[1]):
                    value += layer[channel, i, lane] * observations[i, lane]
            potential = LOW_MV + gain * value
            # In this order a NaN, which only an overflow in the layer could make, reads as the lower end.
            potential = potential if potential > lower else lower
            potentials[neuron, lane] = potential if potential < upper else upper


@kernel
def sum_settled_synapses(program: Program, lanes: LaneParameters, potentials: FloatArray) -> None:
    """Sum up what is constant over a tick: leak and the synapses from driven neurons."""
    current, conductance = lanes.base_current, lanes.base_conductance
    width = potentials.shape[1]
    for d in range(len(program.stepped)):
        for lane in range(width):
            current[d, lane] = lanes.leak_current[d, lane]
            conductance[d, lane] = lanes.conductance[d, lane]
    for s in range(len(program.settled_source)):
        source, slot = program.settled_source[s], program.settled_slot[s]
        reversal = INHIBITORY_MV if program.settled_inhibitory[s] else 0.0
        for lane in range(width):
            z = lanes.settled_slope[s, lane] * (potentials[source, lane] - MIDPOINT_MV)
            gate = lanes.settled_weight[s, lane] / (1.0 + exp2(z))
            conductance[slot, lane] += gate
            current[slot, lane] += reversal * gate
    for s in range(len(program.settled_gap_source)):
        source, slot = program.settled_gap_source[s], program.settled_gap_slot[s]
        for lane in range(width):
            current[slot, lane] += lanes.settled_gap[s, lane] * potentials[source, lane]


@kernel
def step(program: Program, lanes: LaneParameters, potentials: FloatArray) -> None:
    """Advance all stepped neurons by one substep, each from the old potentials of all."""
    gate, current, total = lanes.gate, lanes.current, lanes.total
    width = potentials.shape[1]
    for s in range(len(program.active_source)):
        source = program.active_source[s]
        for lane in range(width):
            z = lanes.active_slope[s, lane] * (potentials[source, lane] - MIDPOINT_MV)
            gate[s, lane] = lanes.active_weight[s, lane] / (1.0 + exp2(z))
    for d in range(len(program.stepped)):
        neuron = program.stepped[d]
        for lane in range(width):
            current[d, lane] = lanes.rate[d, lane] * potentials[neuron, lane] + lanes.base_current[d, lane]
            total[d, lane] = lanes.base_conductance[d, lane]
    for s in range(program.excitatory_count):
        slot = program.active_slot[s]
        for lane in range(width):
            total[slot, lane] += gate[s, lane]
    for s in range(program.excitatory_count, len(program.active_slot)):
        slot = program.active_slot[s]
        for lane in range(width):
            total[slot, lane] += gate[s, lane]
            current[slot, lane] += INHIBITORY_MV * gate[s, lane]
    for s in range(len(program.gap_source)):
        source, slot = program.gap_source[s], program.gap_slot[s]
        for lane in range(width):
            current[slot, lane] += lanes.gap[s, lane] * potentials[source, lane]
    for d in range(len(program.stepped)):
        neuron = program.stepped[d]
        for lane in range(width):
            potentials[neuron, lane] = current[d, lane] / total[d, lane]


@kernel
def read_motors(
    program: Program, lanes: LaneParameters, potentials: FloatArray, commands: FloatArray
) -> None:
    """Read the commands of all lanes from their motor neurons."""
    layer = lanes.output_layer
    channels = lanes.motor if layer.shape[0] else commands
    width = potentials.shape[1]
    channels[:] = 0.0
    for q in range(len(program.motor_neuron)):
        neuron, channel, end = program.motor_neuron[q], program.motor_channel[q], program.motor_end[q]
        for lane in range(width):
            fraction = (potentials[neuron, lane] - program.motor_low) * program.motor_scale
            channels[channel, lane] += end * min(max(fraction, 0.0), 1.0)
    for o in range(layer.shape[0]):
        for lane in range(width):
            value = 0.0
            for i in range(layer.shape[1]):
                value += layer[o, i, lane] * channels[i, lane]
            commands[o, lane] = value


@kernel
def copy_lane(lanes: LaneParameters, lane: int, others: LaneParameters, other: int) -> None:
    """Give a lane the numbers that another set of lanes of the same program holds in lane ``other``."""
    lanes.settled_weight[:, lane] = others.settled_weight[:, other]
    lanes.settled_slope[:, lane] = others.settled_slope[:, other]
    lanes.active_weight[:, lane] = others.active_weight[:, other]
    lanes.active_slope[:, lane] = others.active_slope[:, other]
    lanes.settled_gap[:, lane] = others.settled_gap[:, other]
    lanes.gap[:, lane] = others.gap[:, other]
    lanes.rate[:, lane] = others.rate[:, other]
    lanes.leak_current[:, lane] = others.leak_current[:, other]
    lanes.conductance[:, lane] = others.conductance[:, other]
    lanes.input_layer[:, :, lane] = others.input_layer[:, :, other]
    lanes.output_layer[:, :, lane] = others.output_layer[:, :, other]
