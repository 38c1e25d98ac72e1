"""The solver's definition: one circuit, one equation a line, in plain numpy.

Hasani et al. (ICRA 2020), supplement eq. 1-6.
"""

import numpy as np
from numpy.typing import NDArray

from rover_ncp.circuit.circuit import REVERSAL_MV, Circuit, SynapseKind, conductances
from rover_ncp.circuit.motors import Motors
from rover_ncp.circuit.policy import Policy
from rover_ncp.circuit.sensing import HIGH_MV, LOW_MV, SATURATION_MV, Sensing

FloatArray = NDArray[np.float64]


def tick(policy: Policy, potentials: FloatArray, observation: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the potentials (n,) in mV after a control tick, and the outputs (o,) then read.

    In each substep the sensory neurons are set, then all others step from the old potentials.
    """
    circuit = policy.circuit
    channels = observation
    if policy.input_layer is not None:
        ranges = np.array(policy.sensing.ranges or np.ones(len(observation)))
        channels = policy.input_layer @ (observation / ranges)
    driven = {circuit.neurons[i]: value for i, value in circuit.held.items()}
    driven |= sensory_potentials(policy.sensing, channels)
    potentials = _with(circuit, potentials, driven)
    for _ in range(policy.substeps):
        potentials = _with(circuit, step(circuit, potentials, policy.dt_s), driven)
    values = motor_channels(policy.motors, circuit, potentials)
    if policy.output_layer is not None:
        values = policy.output_layer @ values
        if policy.motors.limits is not None:
            values = np.array(policy.motors.limits) * np.clip(values, -1.0, 1.0)
    return potentials, values


def _with(circuit: Circuit, potentials: FloatArray, driven: dict[str, float]) -> FloatArray:
    changed = potentials.copy()
    for neuron, value in driven.items():
        changed[circuit.index(neuron)] = value
    return changed


def step(circuit: Circuit, potentials: FloatArray, dt_s: float) -> FloatArray:
    """Return the potentials (n,) in mV one hybrid Euler step later (supplement eq. 6).

    Implicit in a neuron's own potential, explicit in those of its presynaptic neurons.
    """
    synapse = conductances(circuit, potentials)
    pull = np.array(
        [
            potentials[source] if kind == SynapseKind.GAP else REVERSAL_MV[SynapseKind(kind)]
            for kind, source in zip(circuit.kind, circuit.source, strict=True)
        ]
    )
    current = circuit.capacitance / dt_s * potentials + circuit.leak * circuit.leak_potential
    total = circuit.capacitance / dt_s + circuit.leak
    np.add.at(current, circuit.destination, synapse * pull)
    np.add.at(total, circuit.destination, synapse)
    new: FloatArray = current / total
    return new


def sensory_potentials(sensing: Sensing, channels: FloatArray) -> dict[str, float]:
    """Return the potential in mV of each sensory neuron for channel values (c,) (supplement eq. 1-2)."""
    potentials = {}
    for channel, value in zip(sensing.channels, channels, strict=True):
        pair = len(channel.sides) == 2
        for neuron, end in channel.sides:
            potential = LOW_MV + (HIGH_MV - LOW_MV) * (value - (channel.origin or 0.0)) / end
            lower = LOW_MV if sensing.clamp or pair else -SATURATION_MV
            upper = HIGH_MV if sensing.clamp else SATURATION_MV
            potentials[neuron] = float(np.clip(potential, lower, upper))
    return potentials


def motor_channels(motors: Motors, circuit: Circuit, potentials: FloatArray) -> FloatArray:
    """Return the motor channels' values (c,) at potentials (n,) in mV (supplement eq. 3)."""
    span = motors.high_mV - motors.low_mV
    values = np.zeros(len(motors.channels))
    for number, channel in enumerate(motors.channels):
        for neuron, end in channel.sides:
            potential = potentials[circuit.index(neuron)]
            values[number] += end * np.clip((potential - motors.low_mV) / span, 0.0, 1.0)
    return values
