"""The published random search on a benchmark, from the best of many starts, with pruned estimates.

The search of mountain car and cart-pole. It deviates from the published search (``published.py``) to need
less time for the same end:
  * It starts from the best of many untuned agents: some tasks reward nothing before the goal.
  * Candidates that trail their incumbent after 1, 3 or 9 rollouts are pruned. A candidate that takes all
    rollouts gets the paper's estimate.
  * After 50 failures the incumbent, which may have been lucky, is estimated in place of a candidate.
  * The search stops at a return that is confirmed as enough, or when for long nothing got better.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from rover_ncp.circuit.policy import Policy
from sim.learn.engine.networks import Net
from sim.learn.search.base import Vector, draw_seeds
from sim.learn.search.published import FAILURES_TO_WIDEN, Caps, Published
from sim.paper.agents import untuned
from sim.paper.evaluator import Evaluator

# Streams of random numbers.
_SEARCH, _ROLLOUTS, _STARTS, _CONFIRM = range(4)
_MIN_AHEAD, _MAX_AHEAD = 4, 48
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
    strategy: str = ""
    """One of the paper's own searches (``published.py``)."""
    warm_up: int = 0
    """Ticks of the agent on the first observation before an episode's first step."""


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


class Reestimating(Published):
    """The published search, with a new estimate of its incumbent after every 50 failures."""

    def wants_estimate(self, adaptation: Caps) -> bool:
        """Replace the failure that would widen the caps."""
        return adaptation.failures == FAILURES_TO_WIDEN - 1

    def after_estimate(self, adaptation: Caps) -> Caps:
        """Widen the caps."""
        return adaptation.after_failure()


def search_randomly(evaluator: Evaluator, agent: Policy | Net, seed: int, budget: Budget) -> Found:
    """Search an agent's parameters on a benchmark. The same arguments give the same bits."""
    generator = generator_of(seed)
    starts = untuned(agent, generator, budget.starts)
    search = Reestimating(agent.layout(), best_starts(evaluator, starts, seed)[0], generator)
    enough = evaluator.task.enough
    curve: list[Point] = []
    gained_at, gained = 0, 0.0
    ended = "evaluations"
    while search.evaluations < budget.evaluations:
        if evaluator.steps >= budget.steps:
            ended = "steps"
            break
        ahead = min(_MIN_AHEAD + search.adaptation.failures, _MAX_AHEAD)
        vectors = search.ask(min(ahead, budget.evaluations - search.evaluations))
        search.tell(estimate(evaluator, vectors, seed, search.evaluations, search.to_beat, budget))
        assert search.value is not None
        if search.value >= enough:
            search.value = confirmed(evaluator, search.incumbent, seed, search.evaluations)
        if not curve or curve[-1].value != search.value:
            curve.append(Point(search.evaluations, evaluator.steps, search.value))
        if search.value >= enough:
            ended = "enough"
            break
        if len(curve) == 1 or search.value > gained + 0.01 * abs(gained):
            gained_at, gained = search.evaluations, search.value
        elif search.evaluations - gained_at > budget.patience:
            ended = "plateau"
            break
    return Found(search.incumbent, search.evaluations, tuple(curve), ended)


def generator_of(seed: int, stream: int = _SEARCH) -> np.random.Generator:
    """Return the generator of a random stream of a search."""
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence(seed, spawn_key=(stream,))))


def estimate(  # noqa: PLR0917
    evaluator: Evaluator,
    vectors: Vector,
    seed: int,
    number: int,
    to_beat: Vector,
    budget: Budget,
    most: float | None = None,
) -> Vector:
    """Return the means (k,) of the worst returns of vectors (k, P); ``number`` is that of the first.

    A candidate takes no more rollouts once its estimate is not above ``to_beat`` (k,). Until then the
    estimate is that of the rollouts so far or, with ``most``, one in which all others return the most.
    """
    count, rollouts = len(vectors), budget.rollouts
    seeds = np.array([draw_seeds(seed, (_ROLLOUTS, number + place), rollouts) for place in range(count)])
    returns = np.full((count, rollouts), np.nan if most is None else most)
    estimates = np.full(count, np.inf)
    left, done = np.arange(count), 0
    early = [] if most == math.inf else [stop for stop in _STOPS if stop < rollouts]
    for stop in (*early, rollouts):
        found = evaluator.run(np.repeat(vectors[left], stop - done, axis=0), seeds[left, done:stop].ravel())
        returns[left, done:stop] = found[:, :2].sum(axis=1).reshape(len(left), -1)
        known = stop if most is None else rollouts
        worst = max(round(budget.worst * known / rollouts), 1)
        lowest = np.sort(returns[left, :known], axis=1)[:, :worst]
        estimates[left] = [math.fsum(row) / worst for row in lowest]
        left, done = left[estimates[left] > to_beat[left]], stop
        if not len(left):
            break
    return estimates


def best_starts(
    evaluator: Evaluator, starts: Vector, seed: int, *, keep: int = 1, horizon: int | None = None
) -> Vector:
    """Return the best of many starts, ``keep`` or more, the best first."""
    left, total = np.arange(len(starts)), np.zeros(len(starts))
    for number, rollouts in enumerate(_START_ROUNDS):
        if number:
            left = left[: max(-(-len(left) // 4), keep)]
        if len(left) <= keep:
            break
        seeds = draw_seeds(seed, (_STARTS, number), rollouts)
        total[left] += evaluator.returns(starts[left], seeds, horizon=horizon).sum(axis=1)
        left = left[np.argsort(-total[left], kind="stable")]
    best: Vector = starts[left]
    return best


def confirmed(judge: Evaluator, vector: Vector, seed: int, evaluation: int) -> float:
    """Return the mean return of many fresh rollouts."""
    return float(judge.returns(vector[None], draw_seeds(seed, (_CONFIRM, evaluation), _CONFIRMATIONS)).mean())
