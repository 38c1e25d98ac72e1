"""Circuits as the text of the published format, for tests of its readers."""

from rover_ncp.circuit.circuit import SynapseKind

WORDS = {SynapseKind.EXCITATORY: "ex", SynapseKind.INHIBITORY: "inh", SynapseKind.GAP: "gj"}


def circuit_to_bnn(circuit):
    """Return the text of a circuit; read back, every number has the same bits."""
    lines = [f"size {circuit.size}"]
    for i in range(circuit.size):
        lines.append(f"cm {i} {float(circuit.capacitance[i])!r}")
        lines.append(f"gleak {i} {float(circuit.leak[i])!r}")
        lines.append(f"vleak {i} {float(circuit.leak_potential[i])!r}")
    lines += [f"const {i} {float(value)!r}" for i, value in circuit.held.items()]
    for s, kind in enumerate(circuit.kind):
        line = f"{WORDS[kind]} {circuit.source[s]} {circuit.destination[s]} {float(circuit.weight[s])!r}"
        lines.append(line if kind == SynapseKind.GAP else f"{line} {float(circuit.sigma[s])!r}")
    return "\n".join(lines) + "\n"
