"""Agents that advance together: each searches on its own, their candidates are evaluated as one batch.

An agent's course depends on the root seed and its own number alone. Which agents share a team, in which
process, and how many iterations are done at a time, changes nothing: the tests hold it to the last bit.
"""

from bisect import bisect_right
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from rover_ncp.circuit.policy import ParameterLayout
from sim.learn.objective import Objective
from sim.learn.search.base import Search, SearchState, Vector
from sim.learn.search.strategies import start_search

__all__ = ["AgentState", "Plan", "Team", "revive"]

# Second element of an agent's spawn keys: what the stream is for.
_SEARCH, _ROLLOUTS = 0, 1


@dataclass(frozen=True)
class Plan:
    """What every process needs to know; it travels between processes by pickle."""

    root_seed: int
    strategy: str
    layout: ParameterLayout
    defaults: Vector
    build_objective: Callable[[], Objective]


@dataclass(frozen=True)
class AgentState:
    """An agent between two iterations. ``search`` is None before its start was evaluated."""

    number: int
    search: SearchState | None = None
    improvements: tuple[tuple[int, float], ...] = field(default=())
    """(iteration, return) wherever the incumbent's return changed; iteration 0 is the start."""

    @property
    def iterations(self) -> int:
        """Candidates judged so far."""
        return max(int(self.search["evaluations"]) - 1, 0) if self.search else 0

    @property
    def value(self) -> float:
        """The incumbent's return; minus infinity before the start was evaluated."""
        return float(self.search["value"]) if self.search else float("-inf")

    def value_at(self, iteration: int) -> float:
        """Return the incumbent's return as it stood after ``iteration``."""
        known = bisect_right(self.improvements, iteration, key=lambda change: change[0])
        return self.improvements[known - 1][1] if known else float("-inf")


class Team:
    """Advances agents by lockstep: every step evaluates one candidate of each as lanes of one batch."""

    def __init__(self, plan: Plan) -> None:
        self._plan = plan
        self._objective = plan.build_objective()

    def advance(self, agents: Sequence[AgentState], iterations: int) -> list[AgentState]:
        """Return the agents after ``iterations`` candidates each; those already there stay as they are."""
        searches = [revive(self._plan, agent) for agent in agents]
        changes: list[list[tuple[int, float]]] = [[] for _ in agents]
        while active := [i for i, s in enumerate(searches) if s.value is None or s.iterations < iterations]:
            asked = [searches[i].ask() for i in active]
            to_beat = np.array([searches[i].to_beat for i in active])
            keys = [(agents[i].number, _ROLLOUTS, searches[i].evaluations) for i in active]
            values = self._objective.estimate(np.concatenate(asked), to_beat, keys)
            for i, value in zip(active, values, strict=True):
                before = searches[i].value
                searches[i].tell([value])
                if searches[i].value != before:
                    changes[i].append((searches[i].iterations, float(value)))
        return [
            AgentState(agent.number, search.state(), agent.improvements + tuple(new))
            for agent, search, new in zip(agents, searches, changes, strict=True)
        ]


def revive(plan: Plan, agent: AgentState) -> Search[Any]:
    """Return the agent's search as it stood. Raises ValueError, KeyError or TypeError for a damaged state."""
    seed = np.random.SeedSequence(plan.root_seed, spawn_key=(agent.number, _SEARCH))
    generator = np.random.Generator(np.random.PCG64(seed))
    search = start_search(plan.strategy, plan.layout, plan.defaults, generator)
    if agent.search is not None:
        search.restore(agent.search)
    return search
