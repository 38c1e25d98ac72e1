"""Independent agents: each searches with its own random stream, and a batch of them shares an evaluator.

The path of an agent depends on the root seed and its number alone. It depends neither on the agents that
share an evaluator or a process with it, nor on the number of iterations that are done at a time.

Rounds of 100 iterations are what the rest of a training sees: progress, checkpoints and the stop condition
see all agents at the same iteration.
"""

import math
from bisect import bisect_right
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from itertools import pairwise
from statistics import median

import numpy as np
from numpy.typing import NDArray

from rover_ncp.circuit.compiled import dead_parameters
from rover_ncp.circuit.policy import Policy
from rover_ncp.core.streams import Domain, random_stream
from sim.learn.engine.evaluator import Evaluator, Stream
from sim.learn.search.base import SearchState, Vector
from sim.learn.search.strategies import start_search
from sim.learn.workers import Workers, answer, made_in_each_process

ROUND_ITERATIONS = 100
"""Short enough for a live display."""
_MAX_AHEAD = 4 * ROUND_ITERATIONS
"""Iterations that an agent may be ahead of the slowest of its batch: waiting agents leave lanes idle."""
_CALL_ITERATIONS = 3000
"""Iterations of a worker in one call, about half a second: lanes run empty at its end, and workers wait for
each other."""


@dataclass(frozen=True)
class Plan:
    """Data that every process needs; it is passed between processes by pickle."""

    root_seed: int
    strategy: str
    start: Policy
    """Its parameters are the defaults of the search."""
    build_evaluator: Callable[[], Evaluator]

    @cached_property
    def inert(self) -> NDArray[np.bool_]:
        """(P,) which parameters have no effect."""
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
        """Return the incumbent's return after ``iteration``, a `curve_point` or the last one."""
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

    @property
    def summary(self) -> str:
        """The returns in a few words."""
        return f"best {self.best.value:.4f}  median {self.median_return:.4f}"


def curve_point(iteration: int) -> int:
    """Return the first point of a learning curve from ``iteration`` on: at most two significant digits."""
    step = int(10 ** max(len(str(iteration - 1)) - 2, 0))
    return -(-iteration // step) * step


def note_improvement(improvements: list[tuple[int, float]], iteration: int, value: float) -> None:
    """Keep a change of the incumbent's return, and drop an earlier one before the same `curve_point`."""
    if improvements and curve_point(improvements[-1][0]) == curve_point(iteration):
        improvements.pop()
    improvements.append((iteration, value))


class Batch:
    """Advances agents side by side in the lanes of one evaluator."""

    def __init__(self, plan: Plan) -> None:
        self._plan = plan
        self._evaluator = plan.build_evaluator()

    def advance(self, agents: Sequence[AgentState], targets: Sequence[int]) -> list[list[AgentState]]:
        """Advance agents to the last of some rising numbers of iterations; return their states at each."""
        runners = [_Runner(self._plan, agent, targets) for agent in agents]
        stream = self._evaluator.stream(len(runners))
        iterations = [runner.search.iterations for runner in runners]
        idle = set(range(len(runners)))
        while True:
            furthest = min(iterations) + _MAX_AHEAD
            # The slowest first: agents far ahead wait for it, and leave lanes idle.
            for index in sorted(idle, key=iterations.__getitem__):
                runner = runners[index]
                if runner.targets and iterations[index] <= furthest:
                    runner.submit(stream, index)
                    idle.remove(index)
            answers = stream.collect()
            if not answers:
                return [runner.at_targets for runner in runners]
            for index, returns, residuals in answers:
                runners[index].tell(returns, residuals)
                iterations[index] = runners[index].search.iterations
                idle.add(index)


class _Runner:
    """An agent on its way to its targets."""

    def __init__(self, plan: Plan, agent: AgentState, targets: Sequence[int]) -> None:
        generator = random_stream(plan.root_seed, Domain.AGENT, agent.number)
        start = plan.start
        self.search = start_search(plan.strategy, start.layout(), start.parameters(), generator, plan.inert)
        if agent.search is not None:
            self.search.restore(agent.search)
        self.targets = deque(targets)
        self.at_targets: list[AgentState] = []
        self._number = agent.number
        self._improvements = list(agent.improvements)
        self._note_targets()

    def submit(self, stream: Stream, index: int) -> None:
        """Let new candidates be evaluated, up to the next target."""
        search = self.search
        left = 1 if search.value is None else self.targets[0] - search.iterations
        room = stream.enough if search.speculates else stream.room
        vectors = search.ask(min(left, search.max_ahead, room))
        stream.submit(index, vectors, search.to_beat)

    def tell(self, returns: Vector, residuals: Vector | None) -> None:
        """Pass returns to the search, and note where its incumbent's return changed."""
        search, value, first = self.search, self.search.value, self.search.evaluations
        for number in range(search.tell(returns, residuals)):
            if value is None or returns[number] > value:
                value = float(returns[number])
                note_improvement(self._improvements, first + number, value)
        if search.value is not None and search.value != value:  # a new estimate of the incumbent is lower
            note_improvement(self._improvements, search.iterations, search.value)
        self._note_targets()

    def _note_targets(self) -> None:
        while self.targets and self.search.value is not None and self.search.iterations >= self.targets[0]:
            self.targets.popleft()
            state = AgentState(self._number, self.search.state(), tuple(self._improvements))
            self.at_targets.append(state)


def _batch(plan: Plan) -> Callable[..., list[list[AgentState]]]:
    return Batch(plan).advance


def split(agents: Sequence[AgentState], count: int) -> list[Sequence[AgentState]]:
    """Return up to ``count`` groups of neighbours whose sizes differ by at most one."""
    count = min(count, len(agents))
    bounds = [len(agents) * i // count for i in range(count + 1)]
    return [agents[a:b] for a, b in pairwise(bounds)]


def _next_targets(snapshot: Snapshot, iterations: int, count: int) -> list[int]:
    """Return the ends of up to ``count`` next rounds; the first round of a run evaluates the start alone."""
    if not snapshot.arrived(0):
        return [0]
    first = snapshot.iterations // ROUND_ITERATIONS + 1
    ends = (min(ROUND_ITERATIONS * number, iterations) for number in range(first, first + count))
    return list(dict.fromkeys(ends))


def run_rounds(
    workers: Workers, plan: Plan, start: Snapshot, iterations: int, after_round: Callable[[Snapshot], bool]
) -> Snapshot:
    """Advance all agents to ``iterations``; ``after_round`` sees every round's end and may stop there.

    Agents that are ahead (of a run that was killed while it saved them) wait for the others. If all have
    arrived, nothing is done and ``after_round`` is not called.
    """
    advance = made_in_each_process(partial(_batch, plan))
    snapshot = start
    while not snapshot.arrived(iterations):
        groups = split(snapshot.agents, workers.count)
        rounds = max(_CALL_ITERATIONS // (ROUND_ITERATIONS * len(groups[-1])), 1)
        if snapshot is start:
            rounds = 1  # with the start of the processes; the speed is measured from its end
        targets = _next_targets(snapshot, iterations, rounds)
        calls = [workers.submit(advance, group, targets) for group in groups]
        states = [
            agent
            for call, group in zip(calls, groups, strict=True)
            for agent in answer(call, list, len(group))
        ]
        for agents in zip(*states, strict=True):
            snapshot = Snapshot(agents)
            if after_round(snapshot):
                return snapshot
    return snapshot
