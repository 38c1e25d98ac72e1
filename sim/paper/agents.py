"""Agents compared on a task: circuits of several wirings, and networks of their size.

circuit    the tap-withdrawal circuit, untuned
random     a random wiring of its size, another one for each seed
mlp, lstm  networks of the published code: 12 cells (the paper: eleven), raw inputs, outputs clipped at ±1
ppo, a2c   a network trained by gradients (``search/gradients.py``)
"""

import math
from dataclasses import replace

from rover_ncp.circuit.policy import Policy
from rover_ncp.core.errors import UsageError
from sim.learn.engine.networks import Net, NetKind, net_for
from sim.learn.random_circuit import random_circuit
from sim.paper.tasks import Task

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
