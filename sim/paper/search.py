"""The search of a benchmark's run: the published one, from the best of many starts, on racing estimates.

By default that of mountain car and cart-pole; with the published budget, that of all benchmarks. Deviations
from the published search, each on the side of less time for the same end:
  * Not one untuned agent is the start but the best of many: some tasks reward nothing before the goal.
  * Estimates race (``racing.py``).
  * After 51 failures the incumbent is estimated again, as Algorithm 1 does: it may have been lucky.
  * The search stops at a return that is confirmed as enough, or when for long nothing got better.
With the published budget it deviates in nothing but the new estimates.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from rover_ncp.circuit.policy import Policy
from sim.learn.networks import Net
from sim.learn.search.base import Vector
from sim.learn.search.published import FAILURES_TO_WIDEN, Caps, Published
from sim.paper.agents import untuned
from sim.paper.arena import Arena, draw_seeds
from sim.paper.racing import Race

# What a stream of random numbers is for.
_SEARCH, _ROLLOUTS, _STARTS, _CONFIRM = range(4)
_LEAST_AHEAD, _MOST_AHEAD = 4, 48
_START_ROUNDS = (1, 2, 4, 8, 16)
_START_SHARE = 4
_CONFIRMATIONS = 100


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
    published: bool = False
    """The paper's search to its end: no races, and no stop at what is enough."""


@dataclass(frozen=True, eq=False)
class Found:
    """Result of a search."""

    vector: Vector
    evaluations: int
    curve: tuple[tuple[int, float], ...]
    """(steps of the environment, estimate of the incumbent) wherever it changed."""
    ended: str


class Reestimating(Published):
    """The published search, which every 51 failures estimates its incumbent again."""

    def wants_estimate(self, adaptation: Caps) -> bool:
        """Instead of the failure that would widen the caps."""
        return adaptation.failures == FAILURES_TO_WIDEN - 1

    def after_estimate(self, adaptation: Caps) -> Caps:
        """Widen the caps."""
        return adaptation.after_failure()


def search_benchmark(
    arena: Arena,
    judge: Arena,
    agent: Policy | Net,
    seed: int,
    budget: Budget,
    *,
    on_progress: Callable[[int, float], None] = lambda steps, value: None,
) -> Found:
    """Search an agent's parameters on a benchmark. The same arguments give the same bits.

    ``judge``, which may be the arena, confirms what is enough.
    """
    task = arena.task
    generator = np.random.Generator(np.random.PCG64(np.random.SeedSequence(seed, spawn_key=(_SEARCH,))))
    starts = untuned(agent, generator, budget.starts)
    search = Reestimating(agent.layout(), best_starts(arena, starts, seed)[0], generator)
    race = Race(arena, seed, budget.rollouts, budget.worst, heated=not budget.published)
    enough = np.inf if budget.published else task.enough
    curve: list[tuple[int, float]] = []
    gained_at, gained = 0, 0.0
    ended = "evaluations"
    while search.evaluations < budget.evaluations:
        if arena.steps >= budget.steps:
            ended = "steps"
            break
        ahead = min(_LEAST_AHEAD + search.adaptation.failures, _MOST_AHEAD)
        vectors = search.ask(min(ahead, budget.evaluations - search.evaluations))
        keys = [(_ROLLOUTS, search.evaluations + number) for number in range(len(vectors))]
        search.tell(race.estimate(vectors, search.to_beat, keys))
        assert search.value is not None
        if search.value >= enough:
            search.value = confirmed(judge, search.incumbent, seed, search.evaluations)
        if not curve or curve[-1][1] != search.value:
            curve.append((arena.steps, search.value))
            on_progress(arena.steps, search.value)
        if search.value >= enough:
            ended = "enough"
            break
        if len(curve) == 1 or search.value > gained + 0.01 * abs(gained):
            gained_at, gained = search.evaluations, search.value
        elif search.evaluations - gained_at > budget.patience:
            ended = "plateau"
            break
    return Found(search.incumbent, search.evaluations, tuple(curve), ended)


def best_starts(arena: Arena, starts: Vector, seed: int) -> Vector:
    """Return the last few of many starts, the best first: a quarter of each round goes on to the next."""
    left, total = np.arange(len(starts)), np.zeros(len(starts))
    for number, rollouts in enumerate(_START_ROUNDS):
        if number:
            left = left[: -(-len(left) // _START_SHARE)]
        if len(left) == 1:
            break
        seeds = draw_seeds(seed, (_STARTS, number), rollouts)
        found = arena.run(np.repeat(starts[left], rollouts, axis=0), np.tile(seeds, len(left)))
        total[left] += found[:, :2].sum(axis=1).reshape(len(left), rollouts).sum(axis=1)
        left = left[np.argsort(-total[left], kind="stable")]
    best: Vector = starts[left]
    return best


def confirmed(arena: Arena, vector: Vector, seed: int, evaluation: int) -> float:
    """Return the mean return of many fresh rollouts."""
    seeds = draw_seeds(seed, (_CONFIRM, evaluation), _CONFIRMATIONS)
    found = arena.run(np.tile(vector, (len(seeds), 1)), seeds)
    return float(found[:, :2].sum(axis=1).mean())
