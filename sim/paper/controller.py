"""Controllers of plants, one in each lane: circuits of one wiring, or networks of one kind.

A kernel is compiled for the types of its arguments. A controller holds both programs and runs one of them,
so the kernel of an episode compiles once for both.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rover_ncp.circuit.circuit import RESTING_MV, SynapseKind, build_circuit
from rover_ncp.circuit.compiled import (
    LaneParameters,
    Program,
    allocate_lanes,
    fill_lane,
    make_program,
    resting_potentials,
)
from rover_ncp.circuit.motors import Motors
from rover_ncp.circuit.policy import Policy
from rover_ncp.circuit.sensing import Channel, Sensing
from rover_ncp.circuit.solver import tick_lanes
from rover_ncp.kernels.jit import kernel
from sim.learn.networks import (
    Net,
    NetKind,
    NetLanes,
    NetProgram,
    allocate_net_lanes,
    fill_net_lane,
    tick_net_lanes,
)

FloatArray = NDArray[np.float64]

_NO_NET = Net(NetKind.MLP, (), (), (), (), (), cells=0)


class Controller(NamedTuple):
    """L lanes of circuits, or of networks."""

    is_net: bool
    inputs: int
    outputs: int
    program: Program
    lanes: LaneParameters
    potentials: FloatArray
    """(n, L) in mV."""
    net: NetProgram
    nets: NetLanes


def make_controller(agent: Policy | Net, count: int) -> Controller:
    """Return ``count`` lanes; ``start_lane`` sets each of them."""
    policy = agent if isinstance(agent, Policy) else _no_policy()
    net = agent if isinstance(agent, Net) else _NO_NET
    program = make_program(policy)
    return Controller(
        is_net=isinstance(agent, Net),
        inputs=len(agent.scale) if isinstance(agent, Net) else len(agent.sensing.inputs),
        outputs=len(agent.high) if isinstance(agent, Net) else len(agent.motors.outputs),
        program=program,
        lanes=allocate_lanes(program, policy, count),
        potentials=resting_potentials(policy, count),
        net=net.program(),
        nets=allocate_net_lanes(net, count),
    )


def _no_policy() -> Policy:
    circuit = build_circuit("none", ("S", "M"), [(SynapseKind.EXCITATORY, 0, 1, 0.0)])
    sensor = Channel(name="x", positive="S", maximum=1.0)
    motor = Channel(name="y", positive="M", maximum=1.0)
    return Policy(
        circuit,
        Sensing(name="none", inputs=("x",), channels=(sensor,)),
        Motors(outputs=("y",), channels=(motor,)),
    )


@kernel
def start_lane(controller: Controller, lane: int, vector: FloatArray) -> None:
    """Set a lane's parameters (P,) and put it at rest."""
    if controller.is_net:
        fill_net_lane(controller.net, controller.nets, lane, vector)
    else:
        fill_lane(controller.program, controller.lanes, lane, vector)
        for neuron in range(controller.potentials.shape[0]):
            controller.potentials[neuron, lane] = RESTING_MV


@kernel
def tick_controller(controller: Controller, observations: FloatArray, commands: FloatArray) -> None:
    """Run all lanes for a tick: from ``observations`` (inputs, L) to ``commands`` (outputs, L)."""
    if controller.is_net:
        tick_net_lanes(controller.net, controller.nets, observations, commands)
    else:
        tick_lanes(controller.program, controller.lanes, controller.potentials, observations, commands)
