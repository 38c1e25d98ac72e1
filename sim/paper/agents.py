"""Agents compared on a task: circuits of several wirings, and networks of their size.

circuit    the tap-withdrawal circuit, untuned
random     a random wiring of its size, another one for each seed
mlp, lstm  networks of eleven cells, with the circuit's inputs and outputs
cfc, ltc   networks of the library ncps with about as many numbers as the circuit
ppo, a2c   a network trained by gradients (``search/gradients.py``)

Any other name is that of a circuit file.
"""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from rover_ncp.circuit import compiled
from rover_ncp.circuit.policy import Policy
from rover_ncp.circuit.policy_file import load_circuit
from rover_ncp.core.errors import UsageError
from sim.learn.engine.networks import Net, NetKind, net_for
from sim.learn.random_circuit import random_circuit
from sim.learn.search.base import Vector
from sim.learn.search.random_search import perturb
from sim.paper import BudgetName
from sim.paper.tasks import Task

GRADIENTS = ("ppo", "a2c")
"""Agents of which only an actor is kept; only torch can train them."""
NETWORKS = ("mlp", "lstm")
PAPERS = ("circuit", "random", "mlp", "lstm")
LIQUID = ("cfc", "ltc")
AGENTS = (*PAPERS, *LIQUID, *GRADIENTS)
_MAX_PERTURBATIONS = 6
_PUBLISHED_CELLS = 12
"""Cells of a network in the published code; the paper says eleven."""


def load_agent(task: Task, circuit: Path) -> Policy:
    """Return the agent of a circuit file.

    Raises FileError, or ConfigError when the circuit lacks a neuron that the task's mapping names.
    """
    return task.policy(load_circuit(circuit))


def build_agent(task: Task, agent: str, seed: int, budget: BudgetName = BudgetName.DEFAULT) -> Policy | Net:
    """Return an untuned agent. Raises UsageError."""
    own = task.circuit()
    if agent == "circuit":
        return task.policy(own)
    if agent == "random":
        return task.policy(random_circuit(seed, own.neurons, own.synapse_count))
    if agent in set(NetKind):
        net = net_for(task.policy(own), NetKind(agent))
        return _as_published(net) if budget is BudgetName.PUBLISHED else net
    raise UsageError(f"no agent {agent!r} to search for; there are {', '.join(AGENTS)}, or --circuit FILE")


def _as_published(net: Net) -> Net:
    """Return the network of the published code: 12 cells, raw inputs, outputs that the environment clips."""
    inputs, outputs = len(net.scale), len(net.high)
    return replace(
        net,
        center=(0.0,) * inputs,
        scale=(1.0,) * inputs,
        most=(math.inf,) * inputs,
        low=(-1.0,) * outputs,
        high=(1.0,) * outputs,
        cells=_PUBLISHED_CELLS,
    )


def dead_parameters(agent: Policy | Net) -> NDArray[np.bool_] | None:
    """Return which parameters (P,) have no effect on the output; None where that is not known."""
    return compiled.dead_parameters(agent) if isinstance(agent, Policy) else None


def untuned(agent: Policy | Net, generator: np.random.Generator, count: int) -> Vector:
    """Draw ``count`` starts (n, P): the first perturbed once, the next twice, and so on to six times, again.

    The published code starts from one perturbation, which leaves most circuits without effect on the world.
    """
    layout = agent.layout()
    rows = []
    for number in range(count):
        row = agent.parameters() if isinstance(agent, Policy) else agent.start(generator)
        for _ in range(1 + number % _MAX_PERTURBATIONS):
            row = perturb(layout, row, generator)
        rows.append(row)
    return np.array(rows)
