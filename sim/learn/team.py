"""Agents that advance together: each searches on its own, their candidates are evaluated as one batch.

An agent's course depends on the root seed and its own number alone. Which agents share a team, in which
process, and how many iterations are done at a time, changes nothing: the tests hold it to the last bit.
"""

from bisect import bisect_right
from collections import deque
from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from rover_ncp.circuit.policy import ParameterLayout
from sim.learn.flow import Flow, Lockstep
from sim.learn.objective import Deterministic, Objective
from sim.learn.search.base import SearchState, Strategy, Vector
from sim.learn.search.strategies import STRATEGIES, start_search

_MOST_AHEAD = 4
"""Rounds that an agent may be ahead of the slowest; an agent that waits leaves lanes idle."""

# Second element of an agent's spawn keys: what the stream is for.
_SEARCH, _ROLLOUTS = 0, 1


@dataclass(frozen=True)
class Plan:
    """Data that every process needs; it is passed between processes by pickle."""

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


Rounds = Generator[list[AgentState], None, None]
"""All agents, as they stand at the end of each round."""


@dataclass
class _Runner:
    """An agent on its way through rounds."""

    number: int
    search: Strategy
    improvements: list[tuple[int, float]]
    arrived: deque[AgentState] = field(default_factory=deque)
    """As it stood at the ends of rounds that others have yet to end."""
    ended: int = 0
    """Rounds."""

    def take_stock(self, targets: Sequence[int]) -> None:
        """Note how it stands wherever a round ends here."""
        while self.ended < len(targets) and self.search.value is not None:
            if self.search.iterations < targets[self.ended]:
                break
            state = AgentState(self.number, self.search.state(), tuple(self.improvements))
            self.arrived.append(state)
            self.ended += 1


class Team:
    """Advances agents side by side: the candidates of all are evaluated together."""

    def __init__(self, plan: Plan) -> None:
        self._plan = plan
        self._objective = plan.build_objective()
        self._flows: dict[int, Flow] = {}

    def advance(self, agents: Sequence[AgentState], iterations: int) -> list[AgentState]:
        """Return the agents after ``iterations`` candidates each; those already there stay as they are."""
        return next(self.rounds(agents, [iterations]))

    def rounds(self, agents: Sequence[AgentState], targets: Sequence[int]) -> Rounds:
        """Give the agents after each of these numbers of candidates, which rise.

        Faster agents go on to the next rounds meanwhile, so that no lane waits for the slowest. The results
        do not depend on that.
        """
        runners = [
            _Runner(agent.number, revive(self._plan, agent), list(agent.improvements)) for agent in agents
        ]
        # A consumer that stops early leaves candidates in the flow, which no other run must receive.
        flow = self._flows.pop(len(agents), None) or self._new_flow(len(agents))
        paused = list(range(len(agents)))
        for given in range(len(targets)):
            going, paused = paused, []
            while True:
                for index in going:
                    runner = runners[index]
                    runner.take_stock(targets)
                    if runner.ended == len(targets):
                        continue
                    if runner.ended > given + _MOST_AHEAD:
                        paused.append(index)
                        continue
                    _submit(flow, index, runner, targets[runner.ended])
                if all(runner.arrived for runner in runners):
                    break
                going = []
                for index, values, misses in flow.collect():
                    runners[index].improvements += _tell(runners[index].search, values, misses)
                    going.append(index)
            if given == len(targets) - 1:
                self._flows[len(agents)] = flow
            yield [runner.arrived.popleft() for runner in runners]

    def _new_flow(self, agents: int) -> Flow:
        strategy, objective = STRATEGIES[self._plan.strategy], self._objective
        if isinstance(objective, Deterministic) and objective.stream is not None:
            return objective.stream(agents)
        return Lockstep(objective, strategy.needs_misses)


def _submit(flow: Flow, index: int, runner: _Runner, target: int) -> None:
    """Ask an agent for candidates, up to a number in all, and let them be evaluated."""
    search = runner.search
    vectors = _ask(search, target, flow)
    evaluations = range(search.evaluations, search.evaluations + len(vectors))
    keys = [(runner.number, _ROLLOUTS, evaluation) for evaluation in evaluations]
    flow.submit(index, vectors, search.to_beat, keys)


def _ask(search: Strategy, iterations: int, flow: Flow) -> Vector:
    left = 1 if search.value is None else iterations - search.iterations
    room = flow.enough if search.speculates else flow.room
    return search.ask(min(left, search.most_ahead, room))


def _tell(search: Strategy, values: Vector, misses: Vector | None) -> list[tuple[int, float]]:
    """Pass values to a search; return the iterations and values of changes of its incumbent's return."""
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
