"""From a policy to what the solver runs: its structure once, its numbers once per lane."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rover_ncp.circuit.circuit import RESTING_MV, ParameterKind, SynapseKind
from rover_ncp.circuit.policy import Policy
from rover_ncp.circuit.solver import LOG2_E, LaneParameters, Program

__all__ = ["lane_parameters", "make_program", "resting_potentials"]

IntArray = NDArray[np.int64]


class _Synapses:
    """A policy's synapses by what the solver does with them; indices into the circuit's arrays.

    Those into driven neurons do nothing and drop out: what drives a neuron overrides them.
    """

    def __init__(self, policy: Policy) -> None:
        circuit = policy.circuit
        drive = policy.sensing.drive(circuit)
        held = [i for i in sorted(circuit.held) if i not in drive.neuron]
        self.drive = drive
        self.held = np.array(held, np.int64)
        self.driven = np.concatenate([drive.neuron, self.held])
        self.stepped = np.setdiff1d(np.arange(circuit.size), self.driven)
        live = np.isin(circuit.destination, self.stepped)
        from_driven = np.isin(circuit.source, self.driven)
        chemical = circuit.chemical
        active = np.flatnonzero(live & chemical & ~from_driven)
        inhibitory = circuit.kind[active] == SynapseKind.INHIBITORY
        self.active = np.concatenate([active[~inhibitory], active[inhibitory]])
        self.excitatory_count = int(np.count_nonzero(~inhibitory))
        self.settled = np.flatnonzero(live & chemical & from_driven)
        self.gap = np.flatnonzero(live & ~chemical & ~from_driven)
        self.settled_gap = np.flatnonzero(live & ~chemical & from_driven)


def make_program(policy: Policy) -> Program:
    """Return the structure of a policy, shared by all its lanes."""
    circuit, synapses = policy.circuit, _Synapses(policy)
    drive, pull = synapses.drive, policy.motors.pull(circuit)
    slot = np.full(circuit.size, -1, np.int64)
    slot[synapses.stepped] = np.arange(len(synapses.stepped))
    held_mV = np.array([circuit.held[i] for i in synapses.held], np.float64)
    nothing = np.zeros(len(held_mV))
    return Program(
        substeps=policy.substeps,
        driven=synapses.driven,
        drive_channel=np.concatenate([drive.channel, np.zeros(len(held_mV), np.int64)]),
        drive_gain=np.concatenate([drive.gain, nothing]),
        drive_lower=np.concatenate([drive.lower, held_mV]),
        drive_upper=np.concatenate([drive.upper, held_mV]),
        stepped=synapses.stepped,
        settled_source=circuit.source[synapses.settled],
        settled_slot=slot[circuit.destination[synapses.settled]],
        settled_inhibitory=circuit.kind[synapses.settled] == SynapseKind.INHIBITORY,
        active_source=circuit.source[synapses.active],
        active_slot=slot[circuit.destination[synapses.active]],
        excitatory_count=synapses.excitatory_count,
        settled_gap_source=circuit.source[synapses.settled_gap],
        settled_gap_slot=slot[circuit.destination[synapses.settled_gap]],
        gap_source=circuit.source[synapses.gap],
        gap_slot=slot[circuit.destination[synapses.gap]],
        motor_neuron=pull.neuron,
        motor_channel=pull.channel,
        motor_end=pull.end,
        motor_low=policy.motors.low_mV,
        motor_scale=1.0 / (policy.motors.high_mV - policy.motors.low_mV),
    )


def lane_parameters(policy: Policy, vectors: ArrayLike) -> LaneParameters:
    """Return the numbers of L lanes from their parameter vectors (L, P), with room for the solver's work.

    The vectors must lie in bounds, as a search keeps them and ``Policy.with_parameters`` checks.
    """
    circuit, synapses, layout = policy.circuit, _Synapses(policy), policy.layout()
    columns = np.ascontiguousarray(np.asarray(vectors, np.float64).T)
    width = columns.shape[1]
    parts = {block.kind: columns[block.slice] for block in layout.blocks}
    empty = np.zeros((0, width))
    weight = parts.get(ParameterKind.WEIGHT, empty)
    slope = np.zeros((circuit.synapse_count, width))
    slope[circuit.chemical] = -LOG2_E * parts.get(ParameterKind.SIGMA, empty)
    stepped = synapses.stepped
    leak = parts[ParameterKind.LEAK][stepped]
    rate = parts[ParameterKind.CAPACITANCE][stepped] / policy.dt_s
    conductance = rate + leak
    slot = {int(neuron): d for d, neuron in enumerate(stepped)}
    for s in (*synapses.settled_gap, *synapses.gap):
        conductance[slot[int(circuit.destination[s])]] += weight[s]
    count, slots = len(synapses.active), len(stepped)
    return LaneParameters(
        settled_weight=weight[synapses.settled],
        settled_slope=slope[synapses.settled],
        active_weight=weight[synapses.active],
        active_slope=slope[synapses.active],
        settled_gap=weight[synapses.settled_gap],
        gap=weight[synapses.gap],
        rate=rate,
        leak_current=leak * parts[ParameterKind.LEAK_POTENTIAL][stepped],
        conductance=conductance,
        input_layer=_layer(parts.get(ParameterKind.INPUT_LAYER), policy.input_layer, width),
        output_layer=_layer(parts.get(ParameterKind.OUTPUT_LAYER), policy.output_layer, width),
        gate=np.empty((count, width)),
        base_current=np.empty((slots, width)),
        base_conductance=np.empty((slots, width)),
        current=np.empty((slots, width)),
        total=np.empty((slots, width)),
        motor=np.empty((len(policy.motors.channels), width)),
    )


def resting_potentials(policy: Policy, width: int) -> NDArray[np.float64]:
    """Return the potentials (n, width) in mV at the start of a run."""
    return np.full((policy.circuit.size, width), RESTING_MV)


def _layer(
    entries: NDArray[np.float64] | None, shaped_like: NDArray[np.float64] | None, width: int
) -> NDArray[np.float64]:
    if entries is None or shaped_like is None:
        return np.zeros((0, 0, width))
    return entries.reshape(*shaped_like.shape, width)
