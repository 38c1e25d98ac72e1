import numpy as np

from paper.tasks import SENSORY, random_circuit
from rover_ncp.circuit.circuit import SynapseKind
from rover_ncp.circuit.policy_file import load_circuit

NEURONS = load_circuit("tap_withdrawal").neurons


def test_random_circuits_have_the_size_asked_for_and_differ():
    circuits = [random_circuit(seed, NEURONS, 28) for seed in range(10)]
    for circuit in circuits:
        assert (circuit.size, circuit.synapse_count) == (11, 28)
        assert not {circuit.neurons[i] for i in circuit.destination} & set(SENSORY)
        assert np.all((circuit.weight >= 0) & (circuit.weight <= 2))
        assert set(circuit.capacitance) == {0.05}
    assert len({tuple(circuit.label(s) for s in range(28)) for circuit in circuits}) == 10
    assert {kind for circuit in circuits for kind in circuit.kind} == set(SynapseKind)
    assert np.array_equal(random_circuit(3, NEURONS, 28).weight, circuits[3].weight)
