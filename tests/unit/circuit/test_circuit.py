import pytest

from rover_ncp.circuit.circuit import SynapseKind
from rover_ncp.circuit.policy_file import load_circuit

# Figure 1 of the paper, transcribed a second time, as "to: from" with ex, in and gap in front.
FIGURE = {
    "AVA": "in PVD, in PLM, ex PVC, in AVB, ex AVD",
    "AVD": "in PLM, ex PVC, in AVA, in AVB, gap AVM, in ALM",
    "PVC": "in PVD, gap PLM, in AVA, ex AVD, in AVM, in ALM, in DVA",
    "AVB": "ex PVC, in AVA, ex AVD, in AVM, in DVA",
    "DVA": "in PVD, in PLM, ex PVC",
}
BENCHMARK = FIGURE | {"FWD": "ex AVB", "REV": "ex AVA"}
PARKING = FIGURE | {"LFT": "ex AVB", "RGT": "ex AVA", "FWD": "ex AVB, ex AVA"}
FOUR_DOF = FIGURE | {"LFT": "ex AVB", "RGT": "ex AVA", "FWD": "ex AVB", "REV": "ex AVA"}
WORDS = {"ex": SynapseKind.EXCITATORY, "in": SynapseKind.INHIBITORY, "gap": SynapseKind.GAP}


@pytest.mark.parametrize(
    ("name", "figure", "synapses"),
    [("tap_withdrawal", BENCHMARK, 28), ("parking", PARKING, 30), ("four_dof", FOUR_DOF, 30)],
)
def test_wiring_is_the_papers(name, figure, synapses):
    circuit = load_circuit(name)
    rows = [(*row.split(), to) for to, sources in figure.items() for row in sources.split(", ")]
    expected = {(WORDS[word], source, destination) for word, source, destination in rows}
    table = zip(circuit.kind, circuit.source, circuit.destination, strict=True)
    wired = {(SynapseKind(kind), circuit.neurons[a], circuit.neurons[b]) for kind, a, b in table}
    assert wired == expected
    assert circuit.synapse_count == synapses
    assert not {circuit.neurons[i] for i in circuit.destination} & {"PVD", "PLM", "AVM", "ALM"}
