"""Agents compared on a task: circuits of several wirings, and networks of their size.

circuit    the tap-withdrawal circuit, untuned
random     a random wiring of its size, another one for each seed
mlp, lstm  networks of the published code: 12 cells (the paper: eleven), raw inputs, outputs clipped at ±1
ppo, a2c   a network trained by gradients (``search/gradients.py``)
"""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from paper.networks import Net, NetKind, net_for
from paper.tasks import Task
from rover_ncp.circuit.circuit import DEFAULTS, Circuit, ParameterKind, SynapseKind
from rover_ncp.circuit.policy import Policy
from rover_ncp.core.errors import UsageError

GRADIENTS = ("ppo", "a2c")
"""Agents of which only an actor is kept; only torch can train them."""
NETWORKS = ("mlp", "lstm")
PAPERS = ("circuit", "random", *NETWORKS)
AGENTS = (*PAPERS, *GRADIENTS)


def build_agent(task: Task, agent: str, seed: int) -> Policy | Net:
    """Return an untuned agent. Raises UsageError."""
    own = task.circuit()
    if agent == "circuit":
        return task.policy(own)
    if agent == "random":
        return task.policy(random_circuit(seed, own.neurons, own.synapse_count))
    if agent in NETWORKS:
        net = net_for(task.policy(own), NetKind(agent))
        zeros, ones, ends = (0.0,) * len(net.scale), (1.0,) * len(net.scale), (1.0,) * len(net.high)
        low, most = tuple(-end for end in ends), (math.inf,) * len(ones)
        return replace(net, center=zeros, scale=ones, most=most, low=low, high=ends, cells=12)
    raise UsageError(f"no agent {agent!r} to search for; there are {', '.join(PAPERS)}")


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


def build_circuit(
    name: str,
    neurons: Sequence[str],
    synapses: Sequence[tuple[SynapseKind, int, int, float]],
    sigma: ArrayLike = DEFAULTS[ParameterKind.SIGMA],
) -> Circuit:
    """Build a circuit from rows (kind, source, destination, weight in S), everything else at its default."""
    n, m = len(neurons), len(synapses)
    columns = [np.array([row[i] for row in synapses], np.int64).reshape(m) for i in range(3)]
    return Circuit(
        name=name,
        neurons=tuple(neurons),
        kind=columns[0],
        source=columns[1],
        destination=columns[2],
        weight=np.array([row[3] for row in synapses], np.float64).reshape(m),
        sigma=np.broadcast_to(np.asarray(sigma, np.float64), (m,)),
        leak_potential=np.full(n, DEFAULTS[ParameterKind.LEAK_POTENTIAL]),
        leak=np.full(n, DEFAULTS[ParameterKind.LEAK]),
        capacitance=np.full(n, DEFAULTS[ParameterKind.CAPACITANCE]),
    )
