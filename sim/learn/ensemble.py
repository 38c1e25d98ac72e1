"""Independent agents that search at the same time, round by round, spread over workers.

All agents do the same number of iterations a round. At a round's end, progress, checkpoint and the stop
condition see all agents at the same iteration. So they see the same state for a seed, for any number and
speed of processes. The agents themselves need not wait for each other.
"""

from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from statistics import median

from sim.learn.team import AgentState
from sim.learn.workers import Workers

ROUND_ITERATIONS = 100
"""Long enough to hide the traffic between processes, short enough for a live display: parts of a second."""


@dataclass(frozen=True)
class Snapshot:
    """The agents at the end of a round."""

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


def run_ensemble(
    workers: Workers, start: Snapshot, iterations: int, after_round: Callable[[Snapshot], bool]
) -> Snapshot:
    """Advance all agents to ``iterations``; ``after_round`` sees every round's end and may stop there.

    Agents that are ahead (a run that was killed while it saved them) wait for the others. If all have
    arrived, nothing is done and ``after_round`` is not called.
    """
    snapshot = start
    if snapshot.arrived(iterations):
        return snapshot
    # First the starts alone: a first picture, and early news of an objective that fails.
    first = snapshot.iterations // ROUND_ITERATIONS + 1 if snapshot.arrived(0) else 0
    targets = [*range(first * ROUND_ITERATIONS, iterations, ROUND_ITERATIONS), iterations]
    with closing(workers.rounds(snapshot.agents, targets)) as rounds:
        for agents in rounds:
            snapshot = Snapshot(tuple(agents))
            if after_round(snapshot):
                break
    return snapshot
