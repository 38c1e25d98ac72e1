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
from sim.learn.flow import Flow, Lockstep
from sim.learn.objective import Deterministic, Objective
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
    """Advances agents side by side: the candidates of all are evaluated together."""

    def __init__(self, plan: Plan) -> None:
        self._plan = plan
        self._objective = plan.build_objective()
        self._flows: dict[int, Flow] = {}

    def advance(self, agents: Sequence[AgentState], iterations: int) -> list[AgentState]:
        """Return the agents after ``iterations`` candidates each; those already there stay as they are."""
        searches = [revive(self._plan, agent) for agent in agents]
        changes: list[list[tuple[int, float]]] = [[] for _ in agents]
        flow = self._flow(len(agents))

        def submit(number: int) -> None:
            search = searches[number]
            if search.value is None or search.iterations < iterations:
                vectors = _ask(search, iterations, flow)
                evaluations = range(search.evaluations, search.evaluations + len(vectors))
                keys = [(agents[number].number, _ROLLOUTS, evaluation) for evaluation in evaluations]
                flow.submit(number, vectors, search.to_beat, keys)

        for number in range(len(agents)):
            submit(number)
        while answers := flow.collect():
            for number, values, misses in answers:
                changes[number] += _tell(searches[number], values, misses)
                submit(number)
        return [
            AgentState(agent.number, search.state(), agent.improvements + tuple(new))
            for agent, search, new in zip(agents, searches, changes, strict=True)
        ]

    def _flow(self, agents: int) -> Flow:
        """Return a flow for so many agents, made once."""
        if agents not in self._flows:
            strategy, objective = STRATEGIES[self._plan.strategy], self._objective
            if isinstance(objective, Deterministic) and objective.stream is not None:
                self._flows[agents] = objective.stream(agents)
            else:
                self._flows[agents] = Lockstep(objective, strategy.needs_misses)
        return self._flows[agents]


def _ask(search: Strategy, iterations: int, flow: Flow) -> Vector:
    left = 1 if search.value is None else iterations - search.iterations
    room = flow.enough if search.speculates else flow.room
    return search.ask(min(left, search.most_ahead, room))


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
