"""Which runs a command line means."""

from collections.abc import Sequence
from pathlib import Path

from rover_ncp.core.errors import UsageError
from sim.paper.agents import AGENTS, GRADIENTS
from sim.paper.cell import Name
from sim.paper.grid import GRID
from sim.paper.tasks import find_task

_OWN_RUNS = 5


def chosen(
    tasks: Sequence[str] | None,
    agents: Sequence[str] | None,
    seeds: Sequence[int] | None,
    circuit: Path | None,
) -> list[Name]:
    """Return the runs asked for, circuits first: those of the grid, or for seeds given outright any.

    Raises UsageError for a task or an agent that is not, and where nothing is left.
    """
    for task in tasks or ():
        find_task(task)
    if circuit is not None:
        if agents or not tasks:
            raise UsageError("--circuit FILE is an agent by itself; it wants a --task")
        return [
            Name(task=task, agent=circuit.stem, seed=seed)
            for task in tasks
            for seed in seeds or range(_OWN_RUNS)
        ]
    for agent in agents or ():
        if agent not in AGENTS:
            raise UsageError(f"no agent {agent!r}; there are {', '.join(AGENTS)}")
    groups = [
        group
        for agent in AGENTS
        for group in GRID
        if group.agent == agent and (not tasks or group.task in tasks) and (not agents or agent in agents)
    ]
    if not agents:
        groups = [group for group in groups if group.agent not in GRADIENTS]
    names = [
        name
        for group in groups
        for name in (
            [Name(task=group.task, agent=group.agent, seed=seed) for seed in seeds]
            if seeds
            else group.names()
        )
    ]
    if not names:
        raise UsageError("the grid has no such runs; rover-ncp paper status lists it")
    return names
