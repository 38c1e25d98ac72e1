"""Effect of every synapse on its neuron at every moment of a run: its current, and its pull in mV.

A current alone misleads: as a neuron rises, the excitation that lifts it gets weaker. The pull of a synapse
compares with the circuit without it. At potentials held for the moment, neuron i heads for

    V_i = (G_i E_L,i + sum_k g_k E_k) / (G_i + sum_k g_k)

with E_k the synapse's reversal potential (a gap junction's is the potential of its source); the pull is V_i
less what it would be with that one synapse cut.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rover_ncp.circuit.circuit import REVERSAL_MV, Circuit, SynapseKind
from rover_ncp.circuit.solver_reference import conductances

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Currents:
    """The synapses of a circuit over T moments."""

    current: FloatArray
    """(T, m) mA; positive raises the destination's potential."""
    pull: FloatArray
    """(T, m) mV."""
    target: FloatArray
    """(T, n) mV, where each neuron was heading."""


def synapse_currents(circuit: Circuit, potentials: FloatArray) -> Currents:
    """Return the currents and pulls of the synapses at potentials (T, n) in mV."""
    conductance = np.array([conductances(circuit, row) for row in potentials])
    chemical = np.array([REVERSAL_MV.get(SynapseKind(kind), 0.0) for kind in circuit.kind])
    reversal = np.where(circuit.chemical, chemical, potentials[:, circuit.source])
    total = np.tile(circuit.leak, (len(potentials), 1))
    current = np.tile(circuit.leak * circuit.leak_potential, (len(potentials), 1))
    for synapse, neuron in enumerate(circuit.destination):
        total[:, neuron] += conductance[:, synapse]
        current[:, neuron] += (conductance * reversal)[:, synapse]
    target = current / total
    to = circuit.destination
    without = (current[:, to] - conductance * reversal) / (total[:, to] - conductance)
    return Currents(
        current=conductance * (reversal - potentials[:, to]),
        pull=target[:, to] - without,
        target=target,
    )
