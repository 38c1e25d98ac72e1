"""What drives the lanes of an episode kernel, each lane with its own parameters: arrays and two kernels.

A lane runner runs a circuit (here); those of the paper's networks are with the paper.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rover_ncp.circuit.circuit import RESTING_MV
from rover_ncp.circuit.compiled import (
    LaneParameters,
    Program,
    allocate_lanes,
    fill_lane,
    make_program,
    resting_potentials,
)
from rover_ncp.circuit.policy import Policy
from rover_ncp.circuit.solver import tick_lanes
from rover_ncp.kernels.jit import inlined_kernel

FloatArray = NDArray[np.float64]


class LaneRunner(NamedTuple):
    """Runs one kind of policy, of P parameters, on all lanes of ``episode_kernel``."""

    size: int
    """P."""
    allocate: Callable[[int], Any]
    """Return the arrays of so many lanes, a named tuple."""
    start_lane: Any
    """Kernel (arrays, lane, vector): set a lane's parameters (P,) and its state at an episode's start."""
    tick_lanes: Any
    """Kernel (arrays, observations, commands): one control tick, (inputs, L) to (2, L)."""


class CircuitLanes(NamedTuple):
    """The arrays of L circuits of one wiring."""

    program: Program
    parameters: LaneParameters
    potentials: FloatArray
    """(n, L) in mV."""


def circuit_lane_runner(policy: Policy) -> LaneRunner:
    """Return what runs a policy's circuit on lanes."""
    program = make_program(policy)

    def allocate(count: int) -> CircuitLanes:
        return CircuitLanes(
            program, allocate_lanes(program, policy, count), resting_potentials(policy, count)
        )

    return LaneRunner(policy.layout().size, allocate, start_circuit, tick_circuits)


@inlined_kernel
def start_circuit(lanes: CircuitLanes, lane: int, vector: FloatArray) -> None:
    """Set a lane's parameters, and every neuron at rest."""
    fill_lane(lanes.program, lanes.parameters, lane, vector)
    lanes.potentials[:, lane] = RESTING_MV


@inlined_kernel
def tick_circuits(lanes: CircuitLanes, observations: FloatArray, commands: FloatArray) -> None:
    """Run all lanes for one control tick."""
    tick_lanes(lanes.program, lanes.parameters, lanes.potentials, observations, commands)
