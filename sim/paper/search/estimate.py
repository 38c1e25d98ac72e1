"""The budget of a search, what it finds, and the estimate of its candidates, on benchmarks and on parking."""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from rover_ncp.circuit.policy import Policy
from rover_ncp.course.course import load_course
from sim.learn.engine import evaluator as engine
from sim.learn.engine.networks import Net, network_commander
from sim.learn.search.base import Vector, draw_seeds
from sim.paper.evaluator import Evaluator
from sim.paper.tasks import Benchmark, Task

_ROLLOUTS = 1
"""Stream of random numbers; others are those of ``search.py``."""
_STOPS = (1, 3, 9)
"""Rollouts after which a candidate may be pruned."""
_CREEP = 5.0
"""Weight of creeping for 9 s in terms of a miss: 5 mm in 2 s, which is not parked any more, cost 0.013."""
UNLIMITED = 10**12


@dataclass(frozen=True)
class Budget:
    """Budget of a run; ``evaluations`` and ``steps`` each end it."""

    rollouts: int
    worst: int
    strategy: str
    """The search: a name of ``SEARCHES`` (``published.py``), or the project's own ``gauss-newton``."""
    evaluations: int = UNLIMITED
    steps: int = UNLIMITED
    starts: int = 1
    warm_up: int = 0
    """Ticks of the agent on the first observation before an episode's first step."""
    prunes: bool = False
    """Whether trailing candidates are pruned, and a plateau or a return that is enough ends the run."""


class Point(NamedTuple):
    """A change of the incumbent's estimate, and the iterations and environment steps before it."""

    iterations: int
    steps: int
    value: float


@dataclass(frozen=True, eq=False)
class Found:
    """Result of a search."""

    vector: Vector
    evaluations: int
    curve: tuple[Point, ...]
    ended: str


class BenchmarkEstimator(Evaluator):
    """The paper's estimate on a benchmark: the mean of the worst k of N rollouts."""

    def __init__(self, task: Benchmark, agent: Policy | Net, seed: int, budget: Budget) -> None:
        super().__init__(task, agent, for_search=True, warm_up=budget.warm_up)
        self._seed, self._budget = seed, budget

    def estimate(self, vectors: Vector, number: int, to_beat: Vector) -> Vector:
        """Return the estimates (k,) of vectors (k, P); ``number`` is that of the first among all evaluations.

        A candidate takes no more rollouts once it cannot exceed ``to_beat`` (k,), as if all others returned
        the most; where the budget prunes, once its rollouts so far do not exceed it.
        """
        count, budget = len(vectors), self._budget
        rollouts, most = budget.rollouts, self.task.most
        seeds = np.array(
            [draw_seeds(self._seed, (_ROLLOUTS, number + place), rollouts) for place in range(count)]
        )
        returns = np.full((count, rollouts), most)
        estimates = np.full(count, np.inf)
        left, done = np.arange(count), 0
        early = [stop for stop in _STOPS if stop < rollouts] if budget.prunes or most < math.inf else []
        for stop in (*early, rollouts):
            found = self.run(np.repeat(vectors[left], stop - done, axis=0), seeds[left, done:stop].ravel())
            returns[left, done:stop] = found[:, :2].sum(axis=1).reshape(len(left), -1)
            known = stop if budget.prunes else rollouts
            worst = max(round(budget.worst * known / rollouts), 1)
            lowest = np.sort(returns[left, :known], axis=1)[:, :worst]
            estimates[left] = [math.fsum(row) / worst for row in lowest]
            left, done = left[estimates[left] > to_beat[left]], stop
            if not len(left):
                break
        return estimates


class ParkingEvaluator:
    """Scores parameter vectors of one agent by the course, without chance. One thread at a time."""

    def __init__(self, task: Task, agent: Policy | Net) -> None:
        course = load_course("parking")
        self.task, self.steps = task, 0
        self._engine = (
            engine.Evaluator(agent, course)
            if isinstance(agent, Policy)
            else engine.Evaluator(task.policy(task.circuit()), course, commander=network_commander(agent))
        )

    def outcome(self, vector: Vector) -> tuple[float, bool]:
        """Return the return of parameters (P,) and whether they park."""
        found = self._engine.outcomes(vector)
        return float(found.total[0, 0]), bool(found.parked[0, 0])

    def traces(self, vectors: Vector) -> tuple[Vector, Vector, Vector]:
        """Return the returns (k,) of vectors (k, P), and the return and residuals that the search climbs.

        The paper's return does not ask for standing still. So motion between the last two checkpoints counts
        as one more miss, which is our addition and in no return that is reported. A rover that can drive
        backward stops only where forward and backward cancel.
        """
        self.steps += len(vectors) * self.task.horizon
        values, residuals = self._engine.run(vectors)
        creep = _CREEP * (residuals[:, :, -1:] - residuals[:, :, -2:-1])
        counted = values - np.sum(creep**2, axis=(1, 2, 3))
        return values, counted, np.concatenate([residuals, creep], axis=2)

    def estimate(self, vectors: Vector, number: int, to_beat: Vector) -> Vector:
        """Return the returns (k,) of vectors (k, P), exact only above ``to_beat`` (k,).

        Without chance, the ``number`` of an evaluation does not matter.
        """
        self.steps += len(vectors) * self.task.horizon
        return self._engine.returns(vectors, to_beat)


Estimator = BenchmarkEstimator | ParkingEvaluator
