"""Trace of one run, simulated or recorded: its motion, its potentials, and the effect of each synapse.

A current alone misleads: as a neuron rises, the excitation that lifts it gets weaker. The pull of a synapse
compares with the circuit without it. At constant potentials, neuron i approaches

    V_i = (G_i E_L,i + sum_k g_k E_k) / (G_i + sum_k g_k)

where E_k is the synapse's reversal potential (for a gap junction the potential of its source). The pull is
V_i minus its value with that one synapse cut.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rover_ncp.circuit.circuit import REVERSAL_MV, Circuit, SynapseKind, conductances
from rover_ncp.circuit.policy import Policy

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Trace:
    """A policy over T control ticks."""

    policy: Policy
    times: FloatArray
    """(T,) s since the first tick, at each tick's start."""
    poses: FloatArray
    """(T + 1, 3) x, y in m and theta in rad in the course frame: at each tick's start, and at the end."""
    commands: FloatArray
    """(T, 2) v and omega."""
    potentials: FloatArray
    """(T, n) mV, at each tick's end."""

    @property
    def neurons(self) -> tuple[str, ...]:
        """The circuit's neurons."""
        return self.policy.circuit.neurons

    @property
    def outputs(self) -> tuple[str, ...]:
        """Names of the columns of ``commands``."""
        return self.policy.motors.outputs

    def of(self, neuron: str) -> FloatArray:
        """Return a neuron's potential over the run, (T,) in mV."""
        potential: FloatArray = self.potentials[:, self.policy.circuit.index(neuron)]
        return potential


def motor_shares(policy: Policy, potentials: FloatArray) -> list[tuple[str, FloatArray]]:
    """Return the contribution of each motor neuron to the command, at potentials (T, n) in mV.

    A contribution is (T, 2) of v and omega for a policy that drives a rover, and (T, outputs) for others. A
    neuron that drives several channels is listed once for each. The sum may exceed an output's limit, which
    only `motor_outputs` applies.
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
    """Return the commands (T, 2), or the outputs of a policy for another task, at potentials (T, n) in mV."""
    outputs: FloatArray = np.sum([share for _, share in motor_shares(policy, potentials)], axis=0)
    limits = policy.motors.limits
    if limits is not None:
        outputs = np.clip(outputs, -np.array(limits), np.array(limits))
    return outputs


@dataclass(frozen=True, eq=False)
class Currents:
    """The synapses of a circuit over T moments."""

    current: FloatArray
    """(T, m) mA; positive raises the destination's potential."""
    pull: FloatArray
    """(T, m) mV."""


def synapse_currents(circuit: Circuit, potentials: FloatArray) -> Currents:
    """Return the currents and pulls of the synapses at potentials (T, n) in mV."""
    conductance = np.array([conductances(circuit, row) for row in potentials])
    chemical = np.array([REVERSAL_MV.get(SynapseKind(kind), 0.0) for kind in circuit.kind])
    reversal = np.where(circuit.chemical, chemical, potentials[:, circuit.source])
    to = circuit.destination
    receives = np.equal.outer(to, np.arange(circuit.size)).astype(float)  # (m, n)
    total = circuit.leak + conductance @ receives
    inflow = circuit.leak * circuit.leak_potential + (conductance * reversal) @ receives
    target = inflow / total
    without = (inflow[:, to] - conductance * reversal) / (total[:, to] - conductance)
    return Currents(
        current=conductance * (reversal - potentials[:, to]),
        pull=target[:, to] - without,
    )
