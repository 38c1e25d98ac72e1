"""CMA-ES on the pendulums and on the half-cheetah, over the unit cube of the parameters' bounds.

Pendulums (``search_by_cma``): the start alone decides a motion, so candidates are compared without noise by
their mean return from a few starts that lie far apart; a new best one must be best from more of them. The
first searches begin at the best untuned agents, the others at the best candidate so far.

Half-cheetah (``search_by_halving``): short episodes show which candidates are better. Each of the best starts
begins a search; after every stage the better half goes on, with longer and more episodes. The winner is the
mean of a distribution with the best return in fresh whole episodes.
"""

from itertools import count
from typing import Any, NamedTuple

import numpy as np

from rover_ncp.circuit.circuit import ParameterKind
from rover_ncp.circuit.policy import Policy
from sim.learn.engine.networks import Net
from sim.learn.search.base import Seeds, Vector, draw_seeds
from sim.learn.search.cma import Cma
from sim.learn.search.unit_box import UnitBox, reflected
from sim.paper.agents import dead_parameters, untuned
from sim.paper.evaluator import Evaluator
from sim.paper.search.estimate import Budget, Found, Point, best_starts, confirmed, generator_of

# Streams of random numbers; others are those of ``estimate.py``.
_DRAW, _SEARCH, _TRIALS, _CHECKS, _FINALS = range(10, 15)
_SPREADS = (0.003, 0.2)
_LARGEST_COVARIANCE = 200
"""Parameters. A larger covariance costs more than the episodes, so it is a diagonal."""

CMA: dict[str, Any] = {
    "population": 16,
    "spread": 0.05,
    "tried_from": 8,
    "checked_from": 32,
    "explored": 4,
    "stale": 40,
}
"""A pendulum's settings, which its run records: starts of the environment that a candidate is tried from, and
that the best one so far is checked from; searches that begin at untuned agents; generations without a better
candidate that end a search."""
_START_POOL = 1000
_EXPLORED_SHARE = 0.1
"""Largest share of a run's steps for each search that begins at an untuned agent."""


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
HALVING: dict[str, Any] = {
    "spread": 0.06,
    "population": 24,
    "stages": [stage._asdict() for stage in STAGES],
}
"""A half-cheetah's settings, which its run records."""
_START_TICKS = 200
_CHECK_EVERY, _CHECK_EPISODES = 10, 4
_FINALISTS, _FINAL_EPISODES = 6, 20


class Search:
    """CMA-ES from one parameter vector (P,). Maximises."""

    def __init__(
        self, agent: Policy | Net, start: Vector, seed: int, *, settings: dict[str, Any], separable: bool
    ) -> None:
        self._box = UnitBox.of(agent.layout(), start, dead_parameters(agent))
        self._cma = Cma(
            self._box.start,
            settings["spread"],
            seed=seed,
            population=settings["population"],
            limits=_SPREADS,
            separable=separable or self._box.size > _LARGEST_COVARIANCE,
        )

    @property
    def mean(self) -> Vector:
        """Parameters (P,) at the mean of the distribution."""
        return self._box.vectors(reflected(self._cma.mean[None])).ravel()

    def ask(self) -> Vector:
        """Return the candidates (population, P) of the next generation."""
        return self._box.vectors(reflected(self._cma.ask()))

    def tell(self, returns: Vector) -> None:
        """Take the returns (population,) of the candidates."""
        self._cma.tell(-returns)


def search_by_cma(
    evaluator: Evaluator, judge: Evaluator, agent: Policy | Net, seed: int, budget: Budget
) -> Found:
    """Search an agent's parameters on a pendulum. The same arguments give the same bits.

    ``judge``, which may be the evaluator, confirms a return that is enough.
    """
    firsts = best_starts(evaluator, _draw_starts(agent, seed, budget.starts), seed)
    explored = min(CMA["explored"], len(firsts))
    checks = spread_seeds(evaluator, seed, CMA["checked_from"])
    trials = checks[: CMA["tried_from"]]
    curve: list[Point] = []
    winner, value, evaluations, searches = firsts[0], -np.inf, 0, 0
    while evaluator.steps < budget.steps:
        explores = searches < explored
        until = budget.steps * (_EXPLORED_SHARE * (searches + 1) if explores else 1.0)
        first = firsts[searches] if explores else winner
        search = Search(agent, first, _search_seed(seed, searches), settings=CMA, separable=False)
        searches += 1
        best_here, stale = -np.inf, 0
        while stale < CMA["stale"] and evaluator.steps < until:
            vectors = search.ask()
            returns = evaluator.returns(vectors, trials).mean(axis=1)
            search.tell(returns)
            evaluations += len(vectors)
            best = int(returns.argmax())
            stale = 0 if returns[best] > best_here else stale + 1
            best_here = max(best_here, float(returns[best]))
            if stale or returns[best] <= value:
                continue
            checked = float(evaluator.returns(vectors[best : best + 1], checks).mean())
            if checked <= value:
                continue
            winner, value = vectors[best], checked
            if value >= evaluator.task.enough:
                value = confirmed(judge, winner, seed, evaluations)
            curve.append(Point(evaluations, evaluator.steps, value))
            if value >= evaluator.task.enough:
                return Found(winner, evaluations, tuple(curve), "enough")
    return Found(winner, evaluations, tuple(curve), "steps")


def spread_seeds(evaluator: Evaluator, seed: int, count: int) -> Seeds:
    """Return seeds (count,) whose starts lie far apart: each as far as possible from those before it."""
    pool = draw_seeds(seed, (_TRIALS,), _START_POOL)
    starts = evaluator.starts(pool)
    widths = np.ptp(starts, axis=0)
    places = (starts - starts.mean(axis=0)) / np.where(widths > 0.0, widths, 1.0)
    chosen = [int((places**2).sum(axis=1).argmin())]
    distances = np.full(len(pool), np.inf)
    while len(chosen) < count:
        distances = np.minimum(distances, ((places - places[chosen[-1]]) ** 2).sum(axis=1))
        chosen.append(int(distances.argmax()))
    return pool[chosen]


class Contender(Search):
    """A search on the half-cheetah with the means it had and their returns in whole episodes."""

    def __init__(self, agent: Policy | Net, start: Vector, seed: int, number: int) -> None:
        super().__init__(agent, start, _search_seed(seed, number), settings=HALVING, separable=True)
        self._seed, self._generations = seed, 0
        self.checked: list[tuple[float, Vector]] = []
        self.standing = -np.inf
        """Recent return of its mean in episodes without a fall."""

    def advance(self, evaluator: Evaluator, stage: Stage) -> int:
        """Do some generations; return how many candidates were evaluated."""
        for _ in range(_CHECK_EVERY):
            seeds = draw_seeds(self._seed, (_TRIALS, self._generations), stage.rollouts)
            self.tell(evaluator.returns(self.ask(), seeds, horizon=stage.ticks).mean(axis=1))
            self._generations += 1
        return _CHECK_EVERY * int(HALVING["population"])

    def check(self, evaluator: Evaluator) -> float:
        """Record and return the return of the mean in fresh episodes."""
        mean = self.mean
        seeds = draw_seeds(self._seed, (_CHECKS, self._generations), _CHECK_EPISODES)
        [returns] = evaluator.returns(mean[None], seeds)
        better = float(np.sort(returns)[len(returns) // 2 :].mean())
        self.standing = better if not self.checked else (self.standing + better) / 2
        self.checked.append((float(returns.mean()), mean))
        return float(returns.mean())


def search_by_halving(evaluator: Evaluator, agent: Policy | Net, seed: int, budget: Budget) -> Found:
    """Search an agent's parameters on the half-cheetah. The same arguments give the same bits."""
    starts = _draw_starts(agent, seed, budget.starts)
    starts = best_starts(evaluator, starts, seed, keep=STAGES[0].searches, horizon=_START_TICKS)
    left = [Contender(agent, start, seed, number) for number, start in enumerate(starts)]
    curve: list[Point] = []
    evaluations = budget.starts
    for stage in STAGES:
        left = sorted(left, key=lambda contender: -contender.standing)[: stage.searches]
        for turn in count():
            if evaluator.steps >= stage.until * budget.steps:
                break
            contender = left[turn % len(left)]
            evaluations += contender.advance(evaluator, stage)
            value = contender.check(evaluator)
            if not curve or value > curve[-1].value:
                curve.append(Point(evaluations, evaluator.steps, value))
    [winner] = left
    finalists = sorted(winner.checked, key=lambda pair: -pair[0])[:_FINALISTS]
    vectors = np.array([vector for _, vector in finalists])
    values = evaluator.returns(vectors, draw_seeds(seed, (_FINALS,), _FINAL_EPISODES)).mean(axis=1)
    return Found(vectors[values.argmax()], evaluations, tuple(curve), "steps")


def _search_seed(seed: int, number: int) -> int:
    return int(draw_seeds(seed, (_SEARCH, number), 1)[0])


def _draw_starts(agent: Policy | Net, seed: int, count: int) -> Vector:
    """Draw untuned agents (count, P), layers at random: a few changes of layers of zeros move nothing."""
    generator = generator_of(seed, _DRAW)
    starts = untuned(agent, generator, count)
    if isinstance(agent, Policy):
        for block in agent.layout().blocks:
            if block.kind in (ParameterKind.INPUT_LAYER, ParameterKind.OUTPUT_LAYER):
                drawn = generator.normal(0.0, 1.0, (count, block.size))
                starts[:, block.slice] = np.clip(drawn, block.lower, block.upper)
    return starts
