"""Random circuits of the tap-withdrawal circuit's size, the paper's control group."""

from collections.abc import Sequence

import numpy as np

from rover_ncp.circuit.circuit import Circuit, SynapseKind, build_circuit
from rover_ncp.core.errors import UsageError

SENSORY = ("PVD", "PLM", "AVM", "ALM")
"""Touch sensors: no synapse leads to them, here as in the tap-withdrawal circuit."""


def random_circuit(seed: int, neurons: Sequence[str], synapses: int) -> Circuit:
    """Return the random circuit of a seed, with exactly so many different synapses.

    As in the supplement: synapses of random kind, from any neuron to any but a sensory one, with weights
    uniform in 0..2 S and all else at its default. The published generator drops a synapse that it has drawn
    before, and so ends with 23 to 28; this one draws another. Raises UsageError for more than there are.
    """
    targets = [number for number, name in enumerate(neurons) if name not in SENSORY]
    possible = len(SynapseKind) * len(neurons) * len(targets)
    if not 0 <= synapses <= possible:
        raise UsageError(f"a random circuit of these neurons has 0..{possible} synapses, not {synapses}")
    generator = np.random.Generator(np.random.PCG64(np.random.SeedSequence(seed)))
    rows: dict[tuple[SynapseKind, int, int], float] = {}
    while len(rows) < synapses:
        kind = SynapseKind(int(generator.integers(len(SynapseKind))))
        source = int(generator.integers(len(neurons)))
        target = targets[int(generator.integers(len(targets)))]
        weight = float(generator.uniform(0.0, 2.0))
        rows.setdefault((kind, source, target), weight)
    table = [(*ends, weight) for ends, weight in rows.items()]
    return build_circuit(f"random-{seed}", neurons, table)
