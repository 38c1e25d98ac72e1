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

import numpy as np

from rover_ncp.circuit.policy import Policy
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


def build_agent(task: Task, agent: str, seed: int, budget: BudgetName = BudgetName.DEFAULT) -> Policy | Net:
    """Return an untuned agent. Raises UsageError."""
    own = task.circuit()
    if agent == "circuit":
        return task.policy(own)
    if agent == "random":
        return task.policy(random_circuit(seed, own.neurons, own.synapse_count))
    if agent in set(NetKind):
        net = net_for(task.policy(own), NetKind(agent))
        if budget is BudgetName.PUBLISHED:
            # The published code has 12 cells (the paper: eleven), raw inputs, and outputs clipped at ±1.
            zeros, ones, ends = (0.0,) * len(net.scale), (1.0,) * len(net.scale), (1.0,) * len(net.high)
            low, most = tuple(-end for end in ends), (math.inf,) * len(ones)
            net = replace(net, center=zeros, scale=ones, most=most, low=low, high=ends, cells=12)
        return net
    raise UsageError(f"no agent {agent!r} to search for; there are {', '.join(AGENTS)}, or --circuit FILE")


def first_vector(agent: Policy | Net, generator: np.random.Generator) -> Vector:
    """Return the parameters (P,) of an untuned agent: a circuit's defaults, a network's random weights."""
    return agent.parameters() if isinstance(agent, Policy) else agent.start(generator)


def untuned(agent: Policy | Net, generator: np.random.Generator, count: int) -> Vector:
    """Draw ``count`` starts (n, P): the first perturbed once, the next twice, and so on to six times, again.

    The published code starts from one perturbation, which leaves most circuits without effect on the world.
    """
    layout = agent.layout()
    rows = []
    for number in range(count):
        row = first_vector(agent, generator)
        for _ in range(1 + number % _MAX_PERTURBATIONS):
            row = perturb(layout, row, generator)
        rows.append(row)
    return np.array(rows)
