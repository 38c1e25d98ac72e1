"""Agents as torch computes them, so that a gradient goes through their solvers: CfC and LTC are the library's
own modules, the circuit's solver is written out.

    student = student_of(agent, vector)
    z, state = student.outputs(seen, state, 0.05)    # (B, T, inputs) to (B, T, outputs)
    loss(z).backward()
    ...
    student.vector()                           # (P,), within its bounds

Outputs are parts of their ranges, without the ends that stop a gradient: those of a network go on; those of a
motor neuron go on with the slope given, where the solver's is 0. Numbers are float64, as in the kernels.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import torch
from ncps.torch import LTC, CfC
from ncps.wirings import FullyConnected
from torch.nn.utils import parameters_to_vector, vector_to_parameters

from rover_ncp.circuit.circuit import MIDPOINT_MV, RESTING_MV, REVERSAL_MV, ParameterKind, SynapseKind
from rover_ncp.circuit.policy import Policy
from sim.learn.liquid import BACKBONE
from sim.learn.networks import Net, NetKind
from sim.learn.search.base import Vector
from sim.learn.search.unit_box import FACTORS, UnitBox


class Student(NamedTuple):
    """An agent that a gradient trains."""

    parameters: list[Any]
    outputs: Callable[[Any, Any, float], tuple[Any, Any]]
    """Observations (B, T, inputs), the state, None at first, and a slope to outputs (B, T, outputs) and the
    state."""
    vector: Callable[[], Vector]
    """Move the parameters into their bounds; return them (P,)."""


def student_of(agent: Policy | Net, vector: Vector) -> Student:
    """Return an agent with the parameters (P,)."""
    return _circuit(agent, vector) if isinstance(agent, Policy) else _network(agent, vector)


def module_of(net: Net) -> tuple[Any, list[Any]]:
    """Return the library's module of a CfC or an LTC, and its parameters in the order of the net's vector."""
    inputs, outputs = len(net.scale), len(net.high)
    if net.kind is NetKind.CFC:
        module = CfC(inputs, net.cells, proj_size=outputs, backbone_units=BACKBONE)
    else:
        module = LTC(inputs, FullyConnected(net.cells, outputs), implicit_param_constraints=False)
    module = module.double()
    named = dict(module.named_parameters())
    return module, [named[tensor.name] for part in net.parts for tensor in part.tensors]


def _network(net: Net, vector: Vector) -> Student:
    module, parameters = module_of(net)
    vector_to_parameters(torch.from_numpy(vector.copy()), parameters)
    center, scale, most = (torch.from_numpy(np.array(each)) for each in (net.center, net.scale, net.most))
    lower, upper = net.layout().lower, net.layout().upper

    def outputs(seen: Any, state: Any, slope: float) -> tuple[Any, Any]:
        if state is None:
            state = torch.zeros(len(seen), net.cells, dtype=torch.float64)
        part = torch.minimum(torch.maximum((seen - center) / scale, -most), most)
        z, state = module(part, state)
        return z, state

    def bounded() -> Vector:
        found: Vector = np.clip(parameters_to_vector(parameters).detach().numpy(), lower, upper)
        vector_to_parameters(torch.from_numpy(found.copy()), parameters)
        return found

    return Student(parameters, outputs, bounded)


def _circuit(policy: Policy, vector: Vector) -> Student:
    """Unroll the solver; the parameters are places within their bounds, as in the search's box."""
    assert policy.input_layer is None and policy.output_layer is None
    circuit, layout = policy.circuit, policy.layout()
    factor = torch.zeros(layout.size, dtype=torch.bool)
    for block in layout.blocks:
        factor[block.slice] = block.kind in FACTORS
    ends = (torch.from_numpy(column) for column in (layout.lower, layout.upper))
    first, last = (torch.where(factor, end.log(), end) for end in ends)
    place = torch.from_numpy(UnitBox.of(layout, vector).start).requires_grad_()

    def values() -> Any:
        value = first + place * (last - first)
        return torch.where(factor, value.exp(), value)

    sensors, motors = policy.sensing.map_onto(circuit), policy.motors.map_from(circuit)
    base, gain, low, high = (torch.from_numpy(column) for column in sensors[2:])
    sensory = torch.from_numpy(sensors.neuron)
    source, chemical = torch.from_numpy(circuit.source.copy()), torch.from_numpy(circuit.chemical)
    into = torch.nn.functional.one_hot(torch.from_numpy(circuit.destination.copy()), circuit.size).double()
    reversal = torch.tensor([REVERSAL_MV.get(SynapseKind(kind), 0.0) for kind in circuit.kind])
    read = torch.zeros(len(motors.neuron), len(policy.motors.channels), dtype=torch.float64)
    for row, (channel, end) in enumerate(zip(motors.channel, motors.end, strict=True)):
        read[row, channel] = end / np.abs(motors.end[motors.channel == channel]).max()
    span = policy.motors.high_mV - policy.motors.low_mV

    def outputs(seen: Any, state: Any, slope: float) -> tuple[Any, Any]:
        vector = values()
        part = {block.kind: vector[block.slice] for block in layout.blocks}
        sigma = torch.zeros(circuit.synapse_count, dtype=torch.float64)
        sigma[chemical] = part[ParameterKind.SIGMA]
        leak, rate = part[ParameterKind.LEAK], part[ParameterKind.CAPACITANCE] / policy.dt_s
        settled = leak * part[ParameterKind.LEAK_POTENTIAL]
        driven = torch.minimum(torch.maximum(base + gain * seen[..., sensors.channel], low), high)
        if state is None:
            state = torch.full((len(seen), circuit.size), RESTING_MV, dtype=torch.float64)
        shown = []
        for tick in range(seen.shape[1]):
            state = state.index_copy(1, sensory, driven[:, tick])
            for _ in range(policy.substeps):
                before = state[:, source]
                opened = torch.where(chemical, torch.sigmoid(sigma * (before - MIDPOINT_MV)), 1.0)
                gate = part[ParameterKind.WEIGHT] * opened
                current = rate * state + settled + (gate * torch.where(chemical, reversal, before)) @ into
                state = (current / (rate + leak + gate @ into)).index_copy(1, sensory, driven[:, tick])
            fraction = (state[:, motors.neuron] - policy.motors.low_mV) / span
            inside = fraction.clamp(0.0, 1.0)
            shown.append((inside + slope * (fraction - inside)) @ read)
        return torch.stack(shown, dim=1), state

    def bounded() -> Vector:
        with torch.no_grad():
            place.clamp_(0.0, 1.0)
            found: Vector = np.clip(values().numpy(), layout.lower, layout.upper)
        return found

    return Student([place], outputs, bounded)
