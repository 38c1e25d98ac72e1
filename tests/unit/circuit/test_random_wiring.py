"""Random circuits: as many synapses as asked for, all different, none to a sensor."""

import numpy as np
import pytest

from rover_ncp.circuit.circuit import SynapseKind
from rover_ncp.circuit.tap_withdrawal import PARKING_NEURONS, SENSORY, random_circuit
from rover_ncp.core.errors import UsageError


@pytest.mark.parametrize("seed", range(10))
def test_has_the_tap_withdrawal_circuits_size(seed):
    circuit = random_circuit(seed)
    assert (circuit.size, circuit.synapse_count) == (11, 28)
    triples = set(zip(circuit.kind, circuit.source, circuit.destination, strict=True))
    assert len(triples) == 28
    assert not {circuit.neurons[i] for i in circuit.destination} & set(SENSORY)
    assert np.all((circuit.weight >= 0) & (circuit.weight <= 2))
    assert set(circuit.capacitance) == {0.05}


def test_seeds_draw_different_wirings_of_all_kinds_and_repeat():
    circuits = [random_circuit(seed) for seed in range(10)]
    wirings = {tuple(circuit.label(s) for s in range(28)) for circuit in circuits}
    assert len(wirings) == 10
    assert {kind for circuit in circuits for kind in circuit.kind} == set(SynapseKind)
    assert np.array_equal(random_circuit(3).weight, circuits[3].weight)


def test_parking_has_two_synapses_more_and_nothing_beyond_all_of_them():
    assert random_circuit(0, PARKING_NEURONS, 30).synapse_count == 30
    assert random_circuit(0, ("A", "B"), 6, ("A",)).synapse_count == 6
    with pytest.raises(UsageError):
        random_circuit(0, ("A", "B"), 7, ("A",))
