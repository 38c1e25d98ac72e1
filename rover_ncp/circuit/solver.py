"""The circuit's solver: many circuits of one wiring, one lane each, advanced together.

Training runs many lanes, the rover one; ``tests/kit/solver_reference.py`` is its definition. A lane has the
same bits for any number of lanes and any place among them: its operations have a fixed order, and the
exponential is our own, so neither a library's version nor a machine's vector width changes a trajectory.

Lanes are worked on in blocks of eight, the width of a vector. Sensory neurons are set, never integrated, and
constant over a tick, so their synapses are summed up once a tick.
"""

import numpy as np

from rover_ncp.circuit.circuit import MIDPOINT_MV, FloatArray
from rover_ncp.circuit.compiled import LaneParameters, Program
from rover_ncp.kernels.jit import inlined_kernel, kernel
from rover_ncp.kernels.vectors import (
    WIDTH,
    everywhere,
    larger,
    load,
    load_lanes,
    scale_by_power_of_two,
    smaller,
    store,
    store_lanes,
)

INHIBITORY_MV = -90.0  # circuit.REVERSAL_MV; the excitatory reversal potential is 0 and drops out

# 2**f on [-1/2, 1/2], interpolated at Chebyshev nodes in 60 digits: relative error below 5e-18.
_C0, _C1, _C2 = 1.0, 0.6931471805599453, 0.24022650695910158
_C3, _C4, _C5 = 0.055504108664821625, 0.009618129107587256, 0.001333355814640647
_C6, _C7, _C8 = 0.00015403530463724353, 1.5252733841556773e-05, 1.3215432535912375e-06
_C9, _C10, _C11 = 1.0178057087733941e-07, 7.074194297288521e-09, 4.4558179083360645e-10
# Adding it rounds a number below 2**51 to an integer, which then stands in the sum's lowest bits.
_ROUNDER = 1.5 * 2.0**52

_ZERO, _ONE = np.uint64(0), np.uint64(1)
"""Unsigned like rows: numba makes a float of the sum of a row and a signed integer."""


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
    result: float = scale_by_power_of_two(low + (middle + high * f4) * f4, shifted)
    return result


@kernel
def divisor(slope: float, potential: float) -> float:
    """Return 1 + exp(-sigma (V - mu)): a chemical synapse conducts its weight divided by this."""
    found: float = 1.0 + exp2(slope * (potential - MIDPOINT_MV))
    return found


@inlined_kernel
def tick_lanes(
    program: Program,
    lanes: LaneParameters,
    potentials: FloatArray,
    observations: FloatArray,
    commands: FloatArray,
) -> None:
    """Run one control tick of L lanes.

    ``potentials`` (n, L) in mV is advanced in place, ``observations`` (inputs, L) are read in the units of
    the sensing, ``commands`` (outputs, L) are written in those of the motors. Observations must be finite.
    """
    potential = lanes.potential
    neurons, count = potentials.shape
    for block in range((count + WIDTH - 1) // WIDTH):
        # Spare lanes of the last block start as copies of its last lane; their results are discarded.
        for neuron in range(neurons):
            store(potential, 0, neuron, load_lanes(potentials, neuron, block * WIDTH))
        set_sensory_neurons(program, lanes, block, observations)
        sum_input_synapses(program, lanes, block)
        run_substeps(program, lanes, block)
        for neuron in range(neurons):
            store_lanes(potentials, neuron, block * WIDTH, load(potential, 0, neuron))
        read_motors(program, lanes, block, commands)


@inlined_kernel
def set_sensory_neurons(
    program: Program, lanes: LaneParameters, block: int, observations: FloatArray
) -> None:
    """Set a block's sensory neurons from its observations."""
    neurons, channels, bases, gains, lowers, uppers = program.sensors
    entries, potentials = lanes.input_layer, lanes.potential
    columns = program.input_layer_at.shape[1]
    for s in range(len(neurons)):
        channel = channels[s]
        if columns == 0:
            value = load_lanes(observations, channel, block * WIDTH)
        else:
            value = everywhere(0.0)
            for i in range(columns):
                entry = load(entries, block, channel * columns + i)
                value = value + entry * load_lanes(observations, i, block * WIDTH)
        # In this order a NaN, which only an overflow in the layer could make, reads as the lower end.
        potential = larger(lowers[s], bases[s] + gains[s] * value)
        store(potentials, 0, neurons[s], smaller(potential, uppers[s]))


@inlined_kernel
def sum_input_synapses(program: Program, lanes: LaneParameters, block: int) -> None:
    """Sum up what is constant over a tick: leak and input synapses."""
    synapses, gaps = program.input_synapses, program.input_gaps
    first, first_inhibitory, source = synapses.first, synapses.first_inhibitory, synapses.source
    first_gap, gap_source = gaps.first, gaps.source
    leak_current, leak_conductance = lanes.leak_current, lanes.conductance
    weight, slope, gap = lanes.input_weight, lanes.input_slope, lanes.input_gap
    potential, currents, totals = lanes.potential, lanes.current, lanes.total
    for d in range(len(program.integrated.neuron)):
        current, total = load(leak_current, block, d), load(leak_conductance, block, d)
        for s in range(first[d], first[d + 1]):
            gate = load(weight, block, s) / divisor(load(slope, block, s), load(potential, 0, source[s]))
            total = total + gate
            if s >= first_inhibitory[d]:
                current = current + INHIBITORY_MV * gate
        for s in range(first_gap[d], first_gap[d + 1]):
            current = current + load(gap, block, s) * load(potential, 0, gap_source[s])
        store(currents, 0, d, current)
        store(totals, 0, d, total)


@inlined_kernel
def run_substeps(program: Program, lanes: LaneParameters, block: int) -> None:
    """Advance a block's integrated neurons by a tick; in a substep each from the old potentials of all."""
    # Local names: numba counts references whenever an array is taken out of a tuple.
    synapses, gaps, neurons = program.recurrent_synapses, program.recurrent_gaps, program.integrated.neuron
    first, first_inhibitory, source = synapses.first, synapses.first_inhibitory, synapses.source
    first_gap, gap_source = gaps.first, gaps.source
    weight, slope, gap, rate = lanes.recurrent_weight, lanes.recurrent_slope, lanes.recurrent_gap, lanes.rate
    potential, currents, totals, following = lanes.potential, lanes.current, lanes.total, lanes.next_potential
    divisors, count = lanes.divisor, np.uint64(len(neurons))
    for _ in range(program.substeps):
        known = _ZERO
        for d in range(count):
            # The next neuron's divisors, too: the processor computes them beside the divisions of this one.
            needed = first[min(d + _ONE + _ONE, count)]
            for s in range(known, needed):
                store(divisors, 0, s, divisor(load(slope, block, s), load(potential, 0, source[s])))
            known = needed
            current = load(currents, 0, d) + load(rate, block, d) * load(potential, 0, neurons[d])
            total = load(totals, 0, d)
            for s in range(first[d], first_inhibitory[d]):
                total = total + load(weight, block, s) / load(divisors, 0, s)
            for s in range(first_inhibitory[d], first[d + _ONE]):
                gate = load(weight, block, s) / load(divisors, 0, s)
                total = total + gate
                current = current + INHIBITORY_MV * gate
            for s in range(first_gap[d], first_gap[d + _ONE]):
                current = current + load(gap, block, s) * load(potential, 0, gap_source[s])
            store(following, 0, d, current / total)
        for d in range(count):
            store(potential, 0, neurons[d], load(following, 0, d))


@inlined_kernel
def read_motors(program: Program, lanes: LaneParameters, block: int, commands: FloatArray) -> None:
    """Read a block's commands from its motor neurons."""
    neurons, targets, ends = program.motors
    low, scale = program.motor_low, program.motor_scale
    entries, potentials, channels = lanes.output_layer, lanes.potential, lanes.channel
    outputs, columns = program.output_layer_at.shape
    limits = program.output_limit
    for channel in range(channels.shape[1]):
        store(channels, 0, channel, everywhere(0.0))
    for q in range(len(neurons)):
        fraction = (load(potentials, 0, neurons[q]) - low) * scale
        pulled = ends[q] * smaller(larger(fraction, 0.0), 1.0)
        store(channels, 0, targets[q], load(channels, 0, targets[q]) + pulled)
    for o in range(commands.shape[0]):
        if outputs == 0:
            value = load(channels, 0, o)
        else:
            value = everywhere(0.0)
            for i in range(columns):
                value = value + load(entries, block, o * columns + i) * load(channels, 0, i)
            if len(limits) > 0:
                value = limits[o] * smaller(larger(value, -1.0), 1.0)
        store_lanes(commands, o, block * WIDTH, value)
