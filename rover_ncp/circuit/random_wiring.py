"""Random circuits of the tap-withdrawal circuit's size, to ask what its wiring is worth.

As in Hasani et al. (ICRA 2020), supplement: synapses of random kind, from any neuron to any but a sensory
one, with weights uniform in 0..2 S and everything else at its default. Where the published generator drops a
synapse that it has drawn before, and so ends with 23 to 28, this one draws another.
"""

from collections.abc import Sequence

import numpy as np

from rover_ncp.circuit.circuit import Circuit, SynapseKind, build_circuit
from rover_ncp.circuit.tap_withdrawal import NEURONS, SENSORY, SYNAPSES
from rover_ncp.core.errors import UsageError

_MOST_WEIGHT_S = 2.0


def random_circuit(
    seed: int,
    neurons: Sequence[str] = NEURONS,
    synapses: int = len(SYNAPSES),
    sensory: Sequence[str] = SENSORY,
) -> Circuit:
    """Return the random circuit of a seed, with exactly so many different synapses.

    Raises UsageError when there are not as many.
    """
    targets = [number for number, name in enumerate(neurons) if name not in sensory]
    possible = len(SynapseKind) * len(neurons) * len(targets)
    if not 0 <= synapses <= possible:
        raise UsageError(f"a random circuit of these neurons has 0..{possible} synapses, not {synapses}")
    generator = np.random.Generator(np.random.PCG64(np.random.SeedSequence(seed)))
    rows: dict[tuple[SynapseKind, int, int], float] = {}
    while len(rows) < synapses:
        kind = SynapseKind(int(generator.integers(len(SynapseKind))))
        source = int(generator.integers(len(neurons)))
        target = targets[int(generator.integers(len(targets)))]
        weight = float(generator.uniform(0.0, _MOST_WEIGHT_S))
        rows.setdefault((kind, source, target), weight)
    table = [(*ends, weight) for ends, weight in rows.items()]
    return build_circuit(f"random-{seed}", neurons, table)
