"""A team: agents of one process that advance side by side in the lanes of one evaluator."""

import math
import time
from collections import deque
from collections.abc import Sequence

from sim.learn.agents import ROUND_ITERATIONS, AgentState, Plan, Progress, curve_point, revive
from sim.learn.evaluator import Stream
from sim.learn.search.base import Vector

_MOST_AHEAD = 4 * ROUND_ITERATIONS
"""Iterations that an agent may be ahead of the slowest in its team; an agent that waits leaves lanes idle."""


class Team:
    """Advances agents side by side in the lanes of one evaluator."""

    def __init__(self, plan: Plan) -> None:
        self._plan = plan
        self._evaluator = plan.build_evaluator()
        self._streams: dict[int, Stream] = {}

    def advance(
        self, agents: Sequence[AgentState], targets: Sequence[Sequence[int]], seconds: float = math.inf
    ) -> list[Progress]:
        """Advance agents for some CPU time, or until each has reached its last target.

        ``targets`` are, for each agent, rising numbers of iterations.
        """
        runners = [_Runner(self._plan, *each) for each in zip(agents, targets, strict=True)]
        if len(runners) not in self._streams:
            self._streams[len(runners)] = self._evaluator.stream(len(runners))
        stream = self._streams[len(runners)]
        ends, in_time = time.thread_time() + seconds, True
        iterations = [runner.search.iterations for runner in runners]
        idle = set(range(len(runners)))
        while True:
            furthest = min(iterations) + _MOST_AHEAD
            # The slowest first: agents far ahead wait for it, and leave lanes idle.
            for index in sorted(idle, key=iterations.__getitem__):
                runner = runners[index]
                if in_time and runner.targets and iterations[index] <= furthest:
                    runner.submit(stream, index)
                    idle.remove(index)
            answers = stream.collect()
            if not answers:
                return [Progress(runner.at_targets, runner.state()) for runner in runners]
            for index, returns, misses in answers:
                runners[index].tell(returns, misses)
                iterations[index] = runners[index].search.iterations
                idle.add(index)
            in_time = time.thread_time() < ends


class _Runner:
    """An agent on its way to its targets."""

    def __init__(self, plan: Plan, agent: AgentState, targets: Sequence[int]) -> None:
        self.search = revive(plan, agent)
        self.targets = deque(targets)
        self.at_targets: list[AgentState] = []
        self._agent = agent
        self._improvements = list(agent.improvements)
        self._note_targets()

    def state(self) -> AgentState:
        if self.search.value is None:
            return self._agent
        return AgentState(self._agent.number, self.search.state(), tuple(self._improvements))

    def submit(self, stream: Stream, index: int) -> None:
        """Let new candidates be evaluated, up to the next target."""
        search = self.search
        left = 1 if search.value is None else self.targets[0] - search.iterations
        room = stream.enough if search.speculates else stream.room
        vectors = search.ask(min(left, search.most_ahead, room))
        stream.submit(index, vectors, search.to_beat)

    def tell(self, returns: Vector, misses: Vector | None) -> None:
        """Pass returns to the search, and note where its incumbent's return changed."""
        search, value, first = self.search, self.search.value, self.search.evaluations
        for number in range(search.tell(returns, misses)):
            if value is None or returns[number] > value:
                value = float(returns[number])
                self._note_change(first + number, value)
        if search.value is not None and search.value != value:  # a new estimate of the incumbent is lower
            self._note_change(search.iterations, search.value)
        self._note_targets()

    def _note_change(self, iteration: int, value: float) -> None:
        """Keep only the last change before each point of the curve: so many do not fill the memory."""
        if self._improvements and curve_point(self._improvements[-1][0]) == curve_point(iteration):
            self._improvements.pop()
        self._improvements.append((iteration, value))

    def _note_targets(self) -> None:
        while self.targets and self.search.value is not None and self.search.iterations >= self.targets[0]:
            self.targets.popleft()
            self.at_targets.append(self.state())
