"""The solver's input as plain tuples of arrays that kernels accept; ``lanes.py`` makes them.

The structure (``Program``) is shared by all lanes, their numbers (``LaneParameters``) are not. A driven
neuron is one that is set, not stepped: a sensory neuron, or one held at a potential.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rover_ncp.circuit.motors import Pull
from rover_ncp.circuit.sensing import Drive

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


class Stepped(NamedTuple):
    """The d neurons that are not driven; a neuron's place here is its slot. ``*_at``: in the vector."""

    neuron: IntArray
    leak_potential_at: IntArray
    leak_at: IntArray
    capacitance_at: IntArray


class Chemical(NamedTuple):
    """Chemical synapses, those of a slot together, its excitatory ones before its inhibitory ones."""

    source: IntArray
    weight_at: IntArray
    sigma_at: IntArray
    first: IntArray
    """(d + 1,) where a slot's synapses begin; the next slot's entry is where they end."""
    first_inhibitory: IntArray
    """(d,) where its inhibitory ones begin."""


class Gaps(NamedTuple):
    """Gap junctions, those of a slot together."""

    source: IntArray
    weight_at: IntArray
    first: IntArray
    """(d + 1,) where a slot's junctions begin."""


class Program(NamedTuple):
    """The structure that all lanes share. Settled synapses come from driven neurons, active ones do not."""

    dt_s: float
    substeps: int
    drive: Drive
    stepped: Stepped
    settled: Chemical
    active: Chemical
    settled_gaps: Gaps
    active_gaps: Gaps
    pull: Pull
    motor_low: float
    motor_scale: float
    """1 / (high - low) of the motors, 1/mV."""
    input_layer_at: IntArray
    output_layer_at: IntArray
    """(channels, inputs) and (outputs, channels): places in the vector; without a layer of shape (0, 0)."""
    input_range: FloatArray
    """(inputs,) what a layer's inputs are divided by."""
    output_limit: FloatArray
    """(outputs,) what a layer's outputs are parts of; of shape (0,) without limits."""


class LaneParameters(NamedTuple):
    """The numbers of all lanes and room to work in, so: one thread at a time.

    B blocks of WIDTH lanes. The contents of spare lanes in the last block are not used.
    """

    settled_weight: FloatArray
    settled_slope: FloatArray
    active_weight: FloatArray
    active_slope: FloatArray
    """(B, synapses, WIDTH) each; a slope is -sigma log2 e."""
    settled_gap: FloatArray
    active_gap: FloatArray
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
    stepped: FloatArray
    """(1, d, WIDTH) each: what is constant over a tick, and the next potentials."""
    channel: FloatArray
    """(1, sensory or motor channels, WIDTH)."""
