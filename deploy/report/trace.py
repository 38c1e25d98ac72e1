"""Trace of one run for the reports, from a simulation or a recording."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rover_ncp.circuit.policy import Policy

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Trace:
    """A policy over T control ticks."""

    policy: Policy
    times: FloatArray
    """(T,) s since the first tick, at each tick's start."""
    poses: FloatArray
    """(T + 1, 3) x, y in m and theta in rad in the course's frame: at each tick's start, and at the end."""
    commands: FloatArray
    """(T, outputs) the circuit's commands."""
    potentials: FloatArray
    """(T, n) mV, as the tick left them."""

    @property
    def neurons(self) -> tuple[str, ...]:
        """The circuit's neurons."""
        return self.policy.circuit.neurons

    def of(self, neuron: str) -> FloatArray:
        """Return a neuron's potential over the run, (T,) in mV."""
        potential: FloatArray = self.potentials[:, self.policy.circuit.index(neuron)]
        return potential


def motor_shares(policy: Policy, potentials: FloatArray) -> list[tuple[str, FloatArray]]:
    """Return what each motor neuron adds to the outputs, (T, outputs), at potentials (T, n) in mV.

    A neuron that drives several channels stands there once for each. Together they may go beyond an output's
    limit, which only `motor_outputs` keeps.
    """
    motors, circuit = policy.motors, policy.circuit
    layer = np.eye(len(motors.channels)) if policy.output_layer is None else policy.output_layer
    if motors.limits is not None:
        layer = np.array(motors.limits)[:, None] * layer
    shares = []
    for number, channel in enumerate(motors.channels):
        for neuron, end in channel.sides:
            potential = potentials[:, circuit.index(neuron)]
            strength = np.clip((potential - motors.low_mV) / (motors.high_mV - motors.low_mV), 0.0, 1.0)
            shares.append((neuron, end * strength[:, None] * layer[:, number]))
    return shares


def motor_outputs(policy: Policy, potentials: FloatArray) -> FloatArray:
    """Return the outputs (T, outputs) that potentials (T, n) in mV mean."""
    outputs: FloatArray = np.sum([share for _, share in motor_shares(policy, potentials)], axis=0)
    limits = policy.motors.limits
    return outputs if limits is None else np.clip(outputs, -np.array(limits), np.array(limits))
