"""Independent agents: each searches with its own random stream, and all of them share the evaluator's lanes.

The path of an agent depends on the root seed and its number alone. It depends neither on the agents that
share a team or a process with it, nor on the number of iterations that are done at a time.

Rounds of 100 iterations are what the rest of a training sees: progress, checkpoints and the stop condition
see all agents at the same iteration. The agents do not wait for each other in between.
"""

import math
from bisect import bisect_right
from collections import deque
from collections.abc import Callable, Generator, Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import cached_property, partial
from itertools import pairwise
from statistics import median
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rover_ncp.circuit.policy import Policy
from rover_ncp.core.streams import Domain, random_stream
from sim.learn.search.base import SearchState, Strategy
from sim.learn.search.strategies import start_search
from sim.learn.workers import MadeOnce, Result, Workers

if TYPE_CHECKING:
    from sim.learn.evaluator import Evaluator

ROUND_ITERATIONS = 100
"""Short enough for a live display."""
_MAX_ROUNDS_AHEAD = 40
"""Rounds that an agent may be ahead of the slowest: their states are kept until all agents have done them."""
_PORTION_S = 0.5
"""CPU time for which a worker advances agents: lanes run empty at its end, and a display waits for it. Not
wall time, in which a busy machine may do too little to be worth handing the agents over."""


@dataclass(frozen=True)
class Plan:
    """Data that every process needs; it is passed between processes by pickle."""

    root_seed: int
    strategy: str
    start: Policy
    """Its parameters are the defaults of the search."""
    build_evaluator: "Callable[[], Evaluator]"

    @cached_property
    def inert(self) -> NDArray[np.bool_]:
        """(P,) which parameters have no effect."""
        from rover_ncp.circuit.compiled import dead_parameters  # kernels: only for workers

        return dead_parameters(self.start)


@dataclass(frozen=True)
class AgentState:
    """An agent between two iterations. ``search`` is None before its start was evaluated."""

    number: int
    search: SearchState | None = None
    improvements: tuple[tuple[int, float], ...] = ()
    """(iteration, return) where the incumbent's return changed, the last one before each `curve_point`;
    iteration 0 is the start."""

    @property
    def iterations(self) -> int:
        """Candidates judged so far."""
        return max(int(self.search["evaluations"]) - 1, 0) if self.search else 0

    @property
    def value(self) -> float:
        """The incumbent's return; minus infinity before the start was evaluated."""
        return float(self.search["value"]) if self.search else -math.inf

    def value_at(self, iteration: int) -> float:
        """Return the incumbent's return as it stood after ``iteration``, a `curve_point` or the last one."""
        known = bisect_right(self.improvements, iteration, key=lambda change: change[0])
        return self.improvements[known - 1][1] if known else -math.inf


@dataclass(frozen=True)
class Snapshot:
    """All agents at the end of a round."""

    agents: tuple[AgentState, ...]

    @property
    def iterations(self) -> int:
        """Iterations that every agent has done."""
        return min(agent.iterations for agent in self.agents)

    @property
    def total_iterations(self) -> int:
        """Iterations of all agents together."""
        return sum(agent.iterations for agent in self.agents)

    def arrived(self, iterations: int) -> bool:
        """Whether every agent has done so many iterations, its start included."""
        return all(agent.search is not None and agent.iterations >= iterations for agent in self.agents)

    @property
    def returns(self) -> list[float]:
        """Each agent's return, by agent number; minus infinity before its start was evaluated."""
        return [agent.value for agent in self.agents]

    @property
    def best(self) -> AgentState:
        """The agent of the highest return, the first of equals."""
        return max(self.agents, key=lambda agent: (agent.value, -agent.number))

    @property
    def median_return(self) -> float:
        """The median of the agents' returns."""
        return float(median(self.returns))


def curve_point(iteration: int) -> int:
    """Return the first point of a learning curve from ``iteration`` on: at most two significant digits."""
    step = int(10 ** max(len(str(iteration - 1)) - 2, 0))
    return -(-iteration // step) * step


class Progress(NamedTuple):
    """What an agent did: its states at the targets that it reached, and its last one."""

    at_targets: list[AgentState]
    last: AgentState


def revive(plan: Plan, agent: AgentState) -> Strategy:
    """Return the agent's search as it stood. Raises ValueError, KeyError or TypeError for a damaged state."""
    generator = random_stream(plan.root_seed, Domain.AGENT, agent.number)
    search = start_search(plan.strategy, plan.start.layout(), plan.start.parameters(), generator, plan.inert)
    if agent.search is not None:
        search.restore(agent.search)
    return search


def _team(plan: Plan) -> Callable[..., list[Progress]]:
    from sim.learn.team import Team  # the engine, which a process that only hands out work never loads

    return Team(plan).advance


def rounds(
    workers: Workers, plan: Plan, agents: Sequence[AgentState], targets: Sequence[int]
) -> Generator[list[AgentState], None, None]:
    """Yield all agents after each of these numbers of iterations, which rise.

    The workers go on while the consumer has a round. Memory does not grow with the number of targets.
    """
    advance = MadeOnce(partial(_team, plan))
    last, reached = list(agents), [0] * len(agents)
    waiting: list[deque[AgentState]] = [deque() for _ in agents]

    def following(index: int) -> Sequence[int]:
        return targets[reached[index] : reached[index] + _MAX_ROUNDS_AHEAD]

    def submit() -> list[tuple[list[int], Result]]:
        behind = [
            index
            for index, count in enumerate(reached)
            if count < len(targets) and len(waiting[index]) < _MAX_ROUNDS_AHEAD
        ]
        return [
            (
                group,
                workers.submit(advance, [last[i] for i in group], [following(i) for i in group], _PORTION_S),
            )
            for group in split(behind, workers.count)
        ]

    pending = submit()
    for _ in targets:
        while not all(waiting):
            for group, future in pending:
                for index, progress in zip(group, future.result(), strict=True):
                    last[index] = progress.last
                    reached[index] += len(progress.at_targets)
                    waiting[index].extend(progress.at_targets)
            pending = submit()
        yield [states.popleft() for states in waiting]


def split(indices: Sequence[int], count: int) -> list[list[int]]:
    """Return up to ``count`` groups of neighbours whose sizes differ by at most one."""
    count = min(count, len(indices))
    bounds = [len(indices) * i // count for i in range(count + 1)] if count else []
    return [list(indices[a:b]) for a, b in pairwise(bounds)]


def run_rounds(
    workers: Workers, plan: Plan, start: Snapshot, iterations: int, after_round: Callable[[Snapshot], bool]
) -> Snapshot:
    """Advance all agents to ``iterations``; ``after_round`` sees every round's end and may stop there.

    Agents that are ahead (of a run that was killed while it saved them) wait for the others. If all have
    arrived, nothing is done and ``after_round`` is not called.
    """
    snapshot = start
    if snapshot.arrived(iterations):
        return snapshot
    # First the starts alone: a first picture, and early news of an evaluator that fails.
    first = snapshot.iterations // ROUND_ITERATIONS + 1 if snapshot.arrived(0) else 0
    whole = range(first * ROUND_ITERATIONS, iterations + 1, ROUND_ITERATIONS)
    for targets in (whole, [iterations] if iterations % ROUND_ITERATIONS else []):
        with closing(rounds(workers, plan, snapshot.agents, targets)) as found:
            for agents in found:
                snapshot = Snapshot(tuple(agents))
                if after_round(snapshot):
                    return snapshot
    return snapshot
