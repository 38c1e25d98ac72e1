"""What the searches share: budgets, results, random streams, starts, and the estimate of a candidate."""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from rover_ncp.circuit.policy import Policy
from sim.learn.engine.networks import Net
from sim.learn.search.base import Vector, draw_seeds
from sim.paper.evaluator import Evaluator
from sim.paper.tasks import Benchmark

# Streams of random numbers.
_SEARCH, _ROLLOUTS, _STARTS, _CONFIRM = range(4)
_START_ROUNDS = (1, 2, 4, 8, 16)
"""Episodes of each start in a round; a quarter of the starts goes on to the next round."""
_CONFIRMATIONS = 100
_STOPS = (1, 3, 9)
"""Rollouts after which a candidate may be pruned."""


@dataclass(frozen=True)
class Budget:
    """Budget of a run; ``evaluations`` and ``steps`` each end it."""

    rollouts: int
    worst: int
    evaluations: int
    steps: int
    starts: int
    patience: int
    """Evaluations without a gain of a hundredth after which a run ends."""
    strategy: str
    """The search: a name of ``SEARCHES`` (``published.py``), or one of ours."""
    warm_up: int = 0
    """Ticks of the agent on the first observation before an episode's first step."""
    prunes: bool = False
    """Whether trailing candidates are pruned and a return that is enough ends the run."""


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


def generator_of(seed: int, stream: int = _SEARCH) -> np.random.Generator:
    """Return the generator of a random stream of a search."""
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence(seed, spawn_key=(stream,))))


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


def best_start(evaluator: Evaluator, starts: Vector, seed: int) -> Vector:
    """Return the best (P,) of many starts (n, P)."""
    left, total = np.arange(len(starts)), np.zeros(len(starts))
    for number, rollouts in enumerate(_START_ROUNDS):
        total[left] += evaluator.returns(starts[left], draw_seeds(seed, (_STARTS, number), rollouts)).sum(
            axis=1
        )
        left = left[np.argsort(-total[left], kind="stable")][: -(-len(left) // 4)]
    best: Vector = starts[left[0]]
    return best


def confirmed(judge: Evaluator, vector: Vector, seed: int, evaluation: int) -> float:
    """Return the mean return of many fresh rollouts."""
    return float(judge.returns(vector[None], draw_seeds(seed, (_CONFIRM, evaluation), _CONFIRMATIONS)).mean())
