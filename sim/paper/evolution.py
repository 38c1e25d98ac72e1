"""The search of the half-cheetah's runs: evolution strategies that race, first by short episodes.

A half-cheetah's reward comes evenly over an episode and depends little on chance. So short episodes show
which candidates are better, and a population can follow them. Each of the best starts begins a search. After
every stage the better half of the searches goes on, with longer and more episodes for each candidate. Early
stages reward speed without a fall; the last ones show which candidates fall from some starts. All candidates
of a generation begin their episodes alike. The winner is the mean of a distribution with the best return in
fresh whole episodes.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rover_ncp.circuit.circuit import ParameterKind
from rover_ncp.circuit.policy import Policy
from sim.learn.networks import Net
from sim.learn.search.base import Vector
from sim.learn.search.unit_box import UnitBox, reflected
from sim.paper.agents import inert, untuned
from sim.paper.arena import Arena, Seeds, draw_seeds
from sim.paper.search import Budget, Found
from sim.paper.separable import Separable

FloatArray = NDArray[np.float64]

# What a stream of random numbers is for.
_DRAW, _SEARCH, _STARTS, _TRIALS, _CHECKS, _FINALS = range(6)
_LAYERS = (ParameterKind.INPUT_LAYER, ParameterKind.OUTPUT_LAYER)
_SPREAD, _POPULATION = 0.06, 24


class Stage(NamedTuple):
    """Number of searches, share of a run's steps at the end, and length and number of episodes."""

    searches: int
    until: float
    ticks: int
    rollouts: int


STAGES = (
    Stage(8, 0.3, 250, 1),
    Stage(4, 0.5, 300, 1),
    Stage(2, 0.7, 400, 2),
    Stage(1, 0.97, 600, 3),
)
EVOLUTION = {
    "spread": _SPREAD,
    "population": _POPULATION,
    "stages": [stage._asdict() for stage in STAGES],
}
"""The search settings that a run records."""
_START_TICKS, _SECOND_LOOKS, _SECOND_SHARE = 200, 4, 10
_CHECK_EVERY, _CHECK_EPISODES = 10, 4
_FINALISTS, _FINAL_EPISODES = 6, 20
_JUDGED = 3
"""Last checks by which a contender stays or goes."""


class Contender:
    """A search from one start, and its means so far with what they did in whole episodes."""

    def __init__(self, agent: Policy | Net, start: Vector, seed: int, number: int) -> None:
        self._box = UnitBox.of(agent.layout(), start, inert(agent))
        self._seed, self._number = seed, number
        [state] = draw_seeds(seed, (_SEARCH, number), 1)
        self._search = Separable(self._box.start, _SPREAD, int(state), _POPULATION)
        self.generations = 0
        self.checked: list[tuple[float, Vector]] = []
        self.standing = -np.inf
        """Recent return of its mean in episodes without a fall."""

    def advance(self, arena: Arena, stage: Stage) -> None:
        """Do one generation."""
        seeds = draw_seeds(self._seed, (_TRIALS, self.generations), stage.rollouts)
        self._search.tell(_returns(arena, self._vectors(self._search.ask()), seeds, stage.ticks).mean(axis=1))
        self.generations += 1

    def check(self, arena: Arena) -> float:
        """Record the return of the mean in fresh episodes."""
        vectors = self._vectors(self._search.mean[None])
        seeds = draw_seeds(self._seed, (_CHECKS, self.generations), _CHECK_EPISODES)
        [returns] = _returns(arena, vectors, seeds)
        better = float(np.sort(returns)[len(returns) // 2 :].mean())
        self.standing = better if not self.checked else (self.standing + better) / 2
        value = float(returns.mean())
        self.checked.append((value, vectors[0]))
        return value

    def _vectors(self, places: FloatArray) -> Vector:
        return self._box.vectors(reflected(places))


def search_by_evolution(
    arena: Arena,
    agent: Policy | Net,
    seed: int,
    budget: Budget,
    on_progress: Callable[[int, float], None] = lambda steps, value: None,
) -> Found:
    """Search an agent's parameters on a benchmark. The same arguments give the same bits."""
    starts = _best_starts(arena, agent, seed, budget.starts)
    left = [Contender(agent, start, seed, number) for number, start in enumerate(starts)]
    curve: list[tuple[int, float]] = []
    evaluations = budget.starts
    for stage in STAGES:
        left = sorted(left, key=lambda contender: -contender.standing)[: stage.searches]
        turn = 0
        while arena.steps < stage.until * budget.steps:
            contender = left[turn % len(left)]
            turn += 1
            for _ in range(_CHECK_EVERY):
                contender.advance(arena, stage)
            evaluations += _CHECK_EVERY * _POPULATION
            value = contender.check(arena)
            if not curve or value > curve[-1][1]:
                curve.append((arena.steps, value))
                on_progress(arena.steps, value)
    [winner] = left
    finalists = sorted(winner.checked, key=lambda pair: -pair[0])[:_FINALISTS]
    vectors = np.array([vector for _, vector in finalists])
    values = _returns(arena, vectors, draw_seeds(seed, (_FINALS,), _FINAL_EPISODES)).mean(axis=1)
    return Found(vectors[values.argmax()], evaluations, tuple(curve), "steps")


def _best_starts(arena: Arena, agent: Policy | Net, seed: int, count: int) -> Vector:
    """Return the best of many starts, (searches of the first stage, P)."""
    [state] = draw_seeds(seed, (_DRAW,), 1)
    generator = np.random.Generator(np.random.PCG64(int(state)))
    starts = untuned(agent, generator, count)
    if isinstance(agent, Policy):
        # A few changes of layers that are all zero move nothing.
        for block in agent.layout().blocks:
            if block.kind in _LAYERS:
                drawn = generator.normal(0.0, 1.0, (count, block.size))
                starts[:, block.slice] = np.clip(drawn, block.lower, block.upper)
    for rollouts, left in ((1, len(starts) // _SECOND_SHARE), (_SECOND_LOOKS, STAGES[0].searches)):
        seeds = draw_seeds(seed, (_STARTS, rollouts), rollouts)
        values = _returns(arena, starts, seeds, _START_TICKS).mean(axis=1)
        starts = starts[np.argsort(-values, kind="stable")[: max(left, STAGES[0].searches)]]
    return starts


def _returns(arena: Arena, vectors: Vector, seeds: Seeds, ticks: int | None = None) -> FloatArray:
    """Return those of each vector's episodes, one for each seed (n, k); one that is lost is the worst."""
    found = arena.run(np.repeat(vectors, len(seeds), axis=0), np.tile(seeds, len(vectors)), horizon=ticks)
    lost = np.isnan(found[:, 0])
    return np.where(lost, -1e6, found[:, 0]).reshape(len(vectors), len(seeds))
