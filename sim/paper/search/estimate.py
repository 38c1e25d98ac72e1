"""The budget of a search, and the estimate of its candidates on benchmarks and on parking."""

import math
from dataclasses import dataclass

import numpy as np

from rover_ncp.circuit.policy import Policy
from rover_ncp.course.course import load_course
from sim.learn.engine import evaluator as engine
from sim.learn.engine.networks import Net
from sim.learn.search.base import Vector, draw_seeds
from sim.paper.evaluator import Evaluator
from sim.paper.tasks import Benchmark, Task

_ROLLOUTS = 1
"""Stream of random numbers; another one is that of ``loop.py``."""
_STOPS = (1, 3, 9)
"""Rollouts after which a candidate may be stopped."""


@dataclass(frozen=True)
class Budget:
    """A search (a name of ``SEARCHES`` in ``published.py``), its iterations, and its estimate's settings."""

    rollouts: int
    worst: int
    strategy: str
    iterations: int
    warm_up: int = 0
    """Ticks of the agent on the first observation before an episode's first step."""


class BenchmarkEstimator(Evaluator):
    """The paper's estimate on a benchmark: the mean of the worst k of N rollouts."""

    def __init__(self, task: Benchmark, agent: Policy | Net, seed: int, budget: Budget) -> None:
        super().__init__(task, agent, for_search=True, warm_up=budget.warm_up)
        self._seed, self._rollouts, self._worst = seed, budget.rollouts, budget.worst

    def estimate(self, vectors: Vector, number: int, to_beat: Vector) -> Vector:
        """Return the estimates (k,) of vectors (k, P); ``number`` is that of the first among all evaluations.

        A candidate takes no more rollouts once it cannot exceed ``to_beat`` (k,), as if all others returned
        the most.
        """
        count, rollouts, most = len(vectors), self._rollouts, self.task.most
        seeds = np.array(
            [draw_seeds(self._seed, (_ROLLOUTS, number + place), rollouts) for place in range(count)]
        )
        returns = np.full((count, rollouts), most)
        estimates = np.full(count, np.inf)
        left, done = np.arange(count), 0
        early = [stop for stop in _STOPS if stop < rollouts] if most < math.inf else []
        for stop in (*early, rollouts):
            found = self.run(np.repeat(vectors[left], stop - done, axis=0), seeds[left, done:stop].ravel())
            returns[left, done:stop] = found[:, :2].sum(axis=1).reshape(len(left), -1)
            lowest = np.sort(returns[left], axis=1)[:, : self._worst]
            estimates[left] = [math.fsum(row) / self._worst for row in lowest]
            left, done = left[estimates[left] > to_beat[left]], stop
            if not len(left):
                break
        return estimates


class ParkingEvaluator:
    """Scores parameter vectors of a circuit by the course, without chance. One thread at a time."""

    def __init__(self, task: Task, policy: Policy) -> None:
        self.task, self.steps = task, 0
        self._engine = engine.Evaluator(policy, load_course("parking"))

    def outcome(self, vector: Vector) -> tuple[float, bool]:
        """Return the return of parameters (P,) and whether they park."""
        found = self._engine.outcomes(vector)
        return float(found.total[0, 0]), bool(found.parked[0, 0])

    def estimate(self, vectors: Vector, number: int, to_beat: Vector) -> Vector:
        """Return the returns (k,) of vectors (k, P), exact only above ``to_beat`` (k,).

        Without chance, the ``number`` of an evaluation does not matter.
        """
        self.steps += len(vectors) * self.task.horizon
        return self._engine.returns(vectors, to_beat)
