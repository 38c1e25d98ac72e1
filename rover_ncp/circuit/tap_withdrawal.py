"""The tap-withdrawal circuit of C. elegans as a table.

Wiring: Hasani et al. (ICRA 2020), figure 1 and supplement; the weights are the untuned starting values of
the published circuits. PVD, PLM, AVM and ALM are touch sensors; AVA and AVB command neurons for backward
and forward; AVD, PVC and DVA lie between. For the benchmarks AVB drives FWD and AVA drives REV; for parking
these two turn the rover left and right, and a third motor neuron, fed by both, drives it forward. With four
degrees of freedom (supplement 6) AVB drives forward alone and AVA backward: forward and to the right at once
then needs both of them, half awake.

Nothing feeds a sensory neuron. 28 of 11 x 11 possible connections exist: a sparsity of 77 %.
"""

from collections.abc import Sequence

import numpy as np

from rover_ncp.circuit.circuit import Circuit, SynapseKind, build_circuit
from rover_ncp.core.errors import UsageError

EX, IN, GAP = SynapseKind.EXCITATORY, SynapseKind.INHIBITORY, SynapseKind.GAP

NEURONS = ("PVD", "PLM", "AVA", "AVD", "PVC", "AVB", "AVM", "ALM", "DVA", "FWD", "REV")
"""In the numbering of the published files."""
SENSORY = ("PVD", "PLM", "AVM", "ALM")
PARKING_NEURONS = (*NEURONS[:9], "LFT", "RGT", "FWD")
"""Parking's names: neurons 9 and 10 turn, the added neuron 11 drives forward."""
FOUR_DOF_NEURONS = (*PARKING_NEURONS, "REV")
"""The same with one more that drives backward."""

# kind, source, destination, weight in S
SYNAPSES: tuple[tuple[SynapseKind, int, int, float], ...] = (
    # to AVA
    (IN, 0, 2, 0.60996),
    (IN, 1, 2, 0.84907),
    (EX, 4, 2, 1.327515),
    (IN, 5, 2, 0.22908),
    (EX, 3, 2, 1.656176),
    # to AVD
    (IN, 1, 3, 0.0),
    (EX, 4, 3, 0.900241),
    (IN, 2, 3, 0.488061),
    (IN, 5, 3, 0.443871),
    (GAP, 6, 3, 1.72995),
    (IN, 7, 3, 0.0),
    # to PVC
    (IN, 0, 4, 0.59057),
    (GAP, 1, 4, 0.0388042),
    (IN, 2, 4, 0.2),
    (EX, 3, 4, 1.343),
    (IN, 6, 4, 0.147041),
    (IN, 7, 4, 0.70817),
    (IN, 8, 4, 0.865243),
    # to AVB
    (EX, 4, 5, 0.948166),
    (IN, 2, 5, 0.58725),
    (EX, 3, 5, 1.53322),
    (IN, 6, 5, 0.926931),
    (IN, 8, 5, 0.872073),
    # to DVA
    (IN, 0, 8, 0.90098),
    (IN, 1, 8, 0.91319),
    (EX, 4, 8, 1.427991),
    # to the two motor neurons of the benchmarks
    (EX, 5, 9, 2.0),
    (EX, 2, 10, 2.0),
)

PARKING_MOTORS: tuple[tuple[SynapseKind, int, int, float], ...] = (
    (EX, 5, 11, 2.0),
    (EX, 2, 11, 2.0),
)
"""Synapses added for parking: both command neurons drive the rover forward."""

FOUR_DOF_MOTORS: tuple[tuple[SynapseKind, int, int, float], ...] = (
    (EX, 5, 11, 2.0),
    (EX, 2, 12, 2.0),
)
"""With four degrees of freedom: the command neuron for forward drives forward, the other backward."""


def tap_withdrawal_circuit() -> Circuit:
    """Return the untuned circuit of the benchmarks: 11 neurons, 28 synapses."""
    return build_circuit("tap_withdrawal", NEURONS, SYNAPSES)


def parking_circuit() -> Circuit:
    """Return the untuned circuit for parking: 12 neurons, 30 synapses."""
    return build_circuit("parking", PARKING_NEURONS, (*SYNAPSES, *PARKING_MOTORS))


def four_dof_circuit() -> Circuit:
    """Return the untuned circuit for parking with four degrees of freedom: 13 neurons, 30 synapses."""
    return build_circuit("four_dof", FOUR_DOF_NEURONS, (*SYNAPSES, *FOUR_DOF_MOTORS))


def random_circuit(
    seed: int,
    neurons: Sequence[str] = NEURONS,
    synapses: int = len(SYNAPSES),
    sensory: Sequence[str] = SENSORY,
) -> Circuit:
    """Return the random circuit of a seed, with exactly so many different synapses.

    As in the supplement: synapses of random kind, from any neuron to any but a sensory one, with weights
    uniform in 0..2 S and all else at its default. The published generator drops a synapse that it has drawn
    before, and so ends with 23 to 28; this one draws another. Raises UsageError for more than there are.
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
        weight = float(generator.uniform(0.0, 2.0))
        rows.setdefault((kind, source, target), weight)
    table = [(*ends, weight) for ends, weight in rows.items()]
    return build_circuit(f"random-{seed}", neurons, table)
