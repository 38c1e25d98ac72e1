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

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rover_ncp.circuit.circuit import RESTING_MV, Circuit, ParameterKind, SynapseKind
from rover_ncp.circuit.policy import ParameterLayout, Policy
from rover_ncp.circuit.program import Chemical, Gaps, LaneParameters, Program, Stepped
from rover_ncp.circuit.sensing import Drive
from rover_ncp.circuit.solver import fill_lane
from rover_ncp.kernels.vectors import WIDTH, aligned_zeros

IntArray = NDArray[np.int64]


def make_program(policy: Policy) -> Program:
    """Return the structure of a policy, shared by all its lanes.

    Synapses into driven neurons drop out: what drives a neuron overrides them.
    """
    circuit, layout = policy.circuit, policy.layout()
    drive = _with_held(policy.sensing.drive(circuit), circuit)
    stepped = np.setdiff1d(np.arange(circuit.size), drive.neuron)
    live = np.isin(circuit.destination, stepped)
    settled = np.isin(circuit.source, drive.neuron)
    chemical = circuit.chemical

    def neurons_at(kind: ParameterKind) -> IntArray:
        at: IntArray = layout.block(kind).slice.start + stepped
        return at

    return Program(
        dt_s=policy.dt_s,
        substeps=policy.substeps,
        drive=drive,
        stepped=Stepped(
            neuron=stepped,
            leak_potential_at=neurons_at(ParameterKind.LEAK_POTENTIAL),
            leak_at=neurons_at(ParameterKind.LEAK),
            capacitance_at=neurons_at(ParameterKind.CAPACITANCE),
        ),
        settled=_chemical(circuit, layout, stepped, live & chemical & settled),
        active=_chemical(circuit, layout, stepped, live & chemical & ~settled),
        settled_gaps=_gaps(circuit, stepped, live & ~chemical & settled),
        active_gaps=_gaps(circuit, stepped, live & ~chemical & ~settled),
        pull=policy.motors.pull(circuit),
        motor_low=policy.motors.low_mV,
        motor_scale=1.0 / (policy.motors.high_mV - policy.motors.low_mV),
        input_layer_at=_layer_at(policy, layout, ParameterKind.INPUT_LAYER),
        output_layer_at=_layer_at(policy, layout, ParameterKind.OUTPUT_LAYER),
        input_range=np.array(policy.sensing.ranges or np.ones(len(policy.sensing.inputs)), np.float64),
        output_limit=np.array(policy.motors.limits or (), np.float64),
    )


def inert_parameters(policy: Policy) -> NDArray[np.bool_]:
    """Return which parameters (P,) no run of a policy depends on: those of driven neurons, mostly."""
    program = make_program(policy)
    chemical = (program.settled, program.active)
    read = [
        *program.stepped[1:],
        *(places for synapses in chemical for places in (synapses.weight_at, synapses.sigma_at)),
        *(gaps.weight_at for gaps in (program.settled_gaps, program.active_gaps)),
        program.input_layer_at.ravel(),
        program.output_layer_at.ravel(),
    ]
    inert = np.ones(policy.layout().size, bool)
    inert[np.concatenate(read)] = False
    return inert


def allocate_lanes(program: Program, policy: Policy, count: int) -> LaneParameters:
    """Return ``count`` lanes with the policy's own parameters, to be set to others by ``fill_lane``.

    The last block's spare lanes keep the policy's, so that they compute nothing but numbers.
    """
    blocks, slots = -(-count // WIDTH), len(program.stepped.neuron)

    def rows(number: int, blocks: int = blocks) -> NDArray[np.float64]:
        return aligned_zeros(blocks, number, WIDTH)

    lanes = LaneParameters(
        settled_weight=rows(len(program.settled.source)),
        settled_slope=rows(len(program.settled.source)),
        active_weight=rows(len(program.active.source)),
        active_slope=rows(len(program.active.source)),
        settled_gap=rows(len(program.settled_gaps.source)),
        active_gap=rows(len(program.active_gaps.source)),
        rate=rows(slots),
        leak_current=rows(slots),
        conductance=rows(slots),
        input_layer=rows(program.input_layer_at.size),
        output_layer=rows(program.output_layer_at.size),
        potential=rows(policy.circuit.size, 1),
        current=rows(slots, 1),
        total=rows(slots, 1),
        stepped=rows(slots, 1),
        channel=rows(len(policy.motors.channels), 1),
    )
    vector = policy.parameters()
    for lane in range(blocks * WIDTH):
        fill_lane(program, lanes, lane, vector)
    return lanes


def lane_parameters(policy: Policy, vectors: ArrayLike) -> LaneParameters:
    """Return lanes set to parameter vectors (L, P), which must lie in bounds."""
    rows = np.asarray(vectors, np.float64)
    program = make_program(policy)
    lanes = allocate_lanes(program, policy, len(rows))
    for lane, vector in enumerate(rows):
        fill_lane(program, lanes, lane, vector)
    return lanes


def resting_potentials(policy: Policy, count: int) -> NDArray[np.float64]:
    """Return the potentials (n, count) in mV at the start of a run."""
    potentials = aligned_zeros(policy.circuit.size, count)
    potentials[:] = RESTING_MV
    return potentials


def _with_held(drive: Drive, circuit: Circuit) -> Drive:
    """Return the drive with the held neurons added: constant, whatever is observed."""
    held = [i for i in sorted(circuit.held) if i not in drive.neuron]
    held_mV = np.array([circuit.held[i] for i in held], np.float64)
    zeros = np.zeros(len(held))
    return Drive(
        neuron=np.concatenate([drive.neuron, np.array(held, np.int64)]),
        channel=np.concatenate([drive.channel, zeros.astype(np.int64)]),
        base=np.concatenate([drive.base, zeros]),
        gain=np.concatenate([drive.gain, zeros]),
        lower=np.concatenate([drive.lower, held_mV]),
        upper=np.concatenate([drive.upper, held_mV]),
    )


def _chemical(
    circuit: Circuit, layout: ParameterLayout, stepped: IntArray, chosen: NDArray[np.bool_]
) -> Chemical:
    synapses = np.flatnonzero(chosen)
    inhibitory = circuit.kind[synapses] == SynapseKind.INHIBITORY
    order = np.lexsort((inhibitory, circuit.destination[synapses]))
    synapses, inhibitory = synapses[order], inhibitory[order]
    first = _first(circuit, stepped, synapses)
    excitatory = [np.count_nonzero(~inhibitory[a:b]) for a, b in pairwise(first)]
    sigma_at = np.cumsum(circuit.chemical) - 1
    if len(synapses):
        sigma_at += layout.block(ParameterKind.SIGMA).slice.start
    return Chemical(
        source=circuit.source[synapses],
        weight_at=synapses,
        sigma_at=sigma_at[synapses],
        first=first,
        first_inhibitory=first[:-1] + np.array(excitatory, np.int64),
    )


def _gaps(circuit: Circuit, stepped: IntArray, chosen: NDArray[np.bool_]) -> Gaps:
    junctions = np.flatnonzero(chosen)
    junctions = junctions[np.argsort(circuit.destination[junctions], kind="stable")]
    return Gaps(
        source=circuit.source[junctions],
        weight_at=junctions,
        first=_first(circuit, stepped, junctions),
    )


def _first(circuit: Circuit, stepped: IntArray, synapses: IntArray) -> IntArray:
    """Return where each slot's synapses begin, and as the last entry where all end."""
    begin = np.searchsorted(circuit.destination[synapses], stepped)
    return np.append(begin, len(synapses)).astype(np.int64)


def _layer_at(policy: Policy, layout: ParameterLayout, kind: ParameterKind) -> IntArray:
    layer = getattr(policy, kind)
    if layer is None:
        return np.zeros((0, 0), np.int64)
    block = layout.block(kind)
    return np.arange(block.slice.start, block.slice.stop).reshape(layer.shape)
