"""The search of the pendulums' runs: CMA-ES, every candidate from the same few starts that lie far apart.

A pendulum's motion follows from its start alone. So candidates are compared by their mean return from one
set of starts, without noise. A few starts that cover the environment's own give nearly as much information as
many random ones. A new best candidate must be best from some more starts too. Such a return has many steps
and cliffs; a distribution averages over them where single changes get stuck. The first searches begin at the
best untuned agents, the others at the best candidate so far. A search without improvement for long ends, and
the next one begins.

A covariance of some hundred parameters costs more than their episodes: above that it is a diagonal.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rover_ncp.circuit.policy import Policy
from sim.learn.networks import Net
from sim.learn.search.base import Vector
from sim.learn.search.cma import Cma
from sim.learn.search.unit_box import UnitBox, reflected
from sim.paper.agents import inert, untuned
from sim.paper.arena import Arena, Seeds, draw_seeds
from sim.paper.search import Budget, Found, best_starts, confirmed
from sim.paper.separable import Separable

FloatArray = NDArray[np.float64]

# What a stream of random numbers is for; others are those of ``search.py``.
_DRAW, _SEARCH, _TRIALS = range(10, 13)
_POPULATION, _SPREAD, _SPREADS = 16, 0.05, (0.003, 0.2)
_TRIED_FROM, _CHECKED_FROM, _POOL = 8, 32, 1000
_EXPLORED, _SHARE = 4, 0.1
"""The number of searches that begin at untuned agents, and the largest share of a run's steps for each."""
_STALE = 40
"""Generations without a better candidate."""
_MOST_ROTATED = 200
CMA: dict[str, Any] = {
    "population": _POPULATION,
    "spread": _SPREAD,
    "tried_from": _TRIED_FROM,
    "checked_from": _CHECKED_FROM,
    "explored": _EXPLORED,
    "stale": _STALE,
}
"""The search settings that a run records."""


def search_by_cma(
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
    generator = np.random.Generator(np.random.PCG64(np.random.SeedSequence(seed, spawn_key=(_DRAW,))))
    firsts = best_starts(arena, untuned(agent, generator, budget.starts), seed)
    explored = min(_EXPLORED, len(firsts))
    checks = seeds_apart(arena, seed, _CHECKED_FROM)
    trials = checks[:_TRIED_FROM]
    curve: list[tuple[int, float]] = []
    winner, value, evaluations, searches = firsts[0], -np.inf, 0, 0
    while arena.steps < budget.steps:
        begins_anew = searches < explored
        until = budget.steps * (_SHARE * (searches + 1) if begins_anew else 1.0)
        box = UnitBox.of(agent.layout(), firsts[searches] if begins_anew else winner, inert(agent))
        [state] = draw_seeds(seed, (_SEARCH, searches), 1)
        search = _start(box, int(state))
        searches += 1
        here, stale = -np.inf, 0
        while stale < _STALE and arena.steps < until:
            vectors = box.vectors(reflected(search.ask()))
            found = _means(arena, vectors, trials)
            search.tell(-found if isinstance(search, Cma) else found)
            evaluations += len(vectors)
            best = int(found.argmax())
            stale = 0 if found[best] > here else stale + 1
            here = max(here, float(found[best]))
            if stale or found[best] <= value:
                continue
            [checked] = _means(arena, vectors[best : best + 1], checks)
            if checked <= value:
                continue
            winner, value = vectors[best], float(checked)
            if value >= arena.task.enough:
                value = confirmed(judge, winner, seed, evaluations)
            curve.append((arena.steps, value))
            on_progress(arena.steps, value)
            if value >= arena.task.enough:
                return Found(winner, evaluations, tuple(curve), "enough")
    return Found(winner, evaluations, tuple(curve), "steps")


def _start(box: UnitBox, state: int) -> "Cma | Separable":
    if box.size > _MOST_ROTATED:
        return Separable(box.start, _SPREAD, state, _POPULATION)
    return Cma(box.start, _SPREAD, seed=state, population=_POPULATION, limits=_SPREADS)


def seeds_apart(arena: Arena, seed: int, count: int) -> Seeds:
    """Return seeds (count,) whose starts lie far apart: each as far as can be from those before it."""
    pool = draw_seeds(seed, (_TRIALS,), _POOL)
    starts = arena.starts(pool)
    widths = np.ptp(starts, axis=0)
    places = (starts - starts.mean(axis=0)) / np.where(widths > 0.0, widths, 1.0)
    chosen = [int((places**2).sum(axis=1).argmin())]
    distances = np.full(len(pool), np.inf)
    while len(chosen) < count:
        distances = np.minimum(distances, ((places - places[chosen[-1]]) ** 2).sum(axis=1))
        chosen.append(int(distances.argmax()))
    return pool[chosen]


def _means(arena: Arena, vectors: Vector, seeds: Seeds) -> FloatArray:
    """Return the mean returns (n,) of vectors (n, P)."""
    found = arena.run(np.repeat(vectors, len(seeds), axis=0), np.tile(seeds, len(vectors)))
    means: FloatArray = found[:, :2].sum(axis=1).reshape(len(vectors), -1).mean(axis=1)
    return means
