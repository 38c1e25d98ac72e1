"""Agents that advance together: each searches on its own, their candidates are evaluated as one batch.

An agent's course depends on the root seed and its own number alone. Which agents share a team, in which
process, and how many iterations are done at a time, changes nothing: the tests hold it to the last bit.
"""

from bisect import bisect_right
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from rover_ncp.circuit.policy import ParameterLayout
from sim.learn.objective import Objective
from sim.learn.search.base import SearchState, Strategy, Vector
from sim.learn.search.strategies import STRATEGIES, start_search

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
    inert: NDArray[np.bool_] | None = None
    """(P,) which parameters have no effect, where that is known."""


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
    """Advances agents by lockstep: every step evaluates the candidates of all as lanes of one batch."""

    def __init__(self, plan: Plan) -> None:
        self._plan = plan
        self._objective = plan.build_objective()
        self._needs_misses = STRATEGIES[plan.strategy].needs_misses

    def advance(self, agents: Sequence[AgentState], iterations: int) -> list[AgentState]:
        """Return the agents after ``iterations`` candidates each; those already there stay as they are."""
        searches = [revive(self._plan, agent) for agent in agents]
        changes: list[list[tuple[int, float]]] = [[] for _ in agents]
        while active := [i for i, s in enumerate(searches) if s.value is None or s.iterations < iterations]:
            asked = [_ask(searches[i], iterations) for i in active]
            keys = [
                (agents[i].number, _ROLLOUTS, searches[i].evaluations + ahead)
                for i, candidates in zip(active, asked, strict=True)
                for ahead in range(len(candidates))
            ]
            counts = [len(candidates) for candidates in asked]
            to_beat = np.repeat([searches[i].to_beat for i in active], counts)
            values, misses = self._evaluate(np.concatenate(asked), to_beat, keys)
            first = 0
            for i, count in zip(active, counts, strict=True):
                part = slice(first, first + count)
                changes[i] += _tell(searches[i], values[part], None if misses is None else misses[part])
                first += count
        return [
            AgentState(agent.number, search.state(), agent.improvements + tuple(new))
            for agent, search, new in zip(agents, searches, changes, strict=True)
        ]

    def _evaluate(
        self, vectors: Vector, to_beat: Vector, keys: Sequence[tuple[int, ...]]
    ) -> tuple[Vector, Vector | None]:
        if self._needs_misses:
            return self._objective.trace(vectors)
        return self._objective.estimate(vectors, to_beat, keys), None


def _ask(search: Strategy, iterations: int) -> Vector:
    left = 1 if search.value is None else iterations - search.iterations
    return search.ask(min(left, search.most_ahead))


def _tell(search: Strategy, values: Vector, misses: Vector | None) -> list[tuple[int, float]]:
    """Tell a search; return the iterations at which its incumbent's return changed, and to what."""
    value, evaluations = search.value, search.evaluations
    changes = []
    for number in range(search.tell(values, misses)):
        if value is None or values[number] > value:
            value = float(values[number])
            changes.append((evaluations + number, value))
    if search.value is not None and search.value != value:  # the incumbent was found to be worth less
        changes.append((search.iterations, search.value))
    return changes


def revive(plan: Plan, agent: AgentState) -> Strategy:
    """Return the agent's search as it stood. Raises ValueError, KeyError or TypeError for a damaged state."""
    seed = np.random.SeedSequence(plan.root_seed, spawn_key=(agent.number, _SEARCH))
    generator = np.random.Generator(np.random.PCG64(seed))
    search = start_search(plan.strategy, plan.layout, plan.defaults, generator, plan.inert)
    if agent.search is not None:
        search.restore(agent.search)
    return search
