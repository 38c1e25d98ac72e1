"""Estimates of a return from several rollouts, most candidates of which are out after the first.

The paper takes N rollouts and averages the worst k. Most candidates are far worse than what they must beat,
which one rollout shows. So rollouts come in heats: who is not ahead after a heat, judged by the same share of
worst ones, is out, and what is returned for it is what it had. A candidate that stays in all heats gets the
paper's estimate. A search asks only whether a candidate beats its incumbent, so racing loses it some lucky
candidates late, and no others.
"""

from collections.abc import Sequence

import numpy as np

from sim.learn.objective import mean_of_worst
from sim.learn.search.base import Vector
from sim.paper.arena import Arena, draw_seeds

Key = tuple[int, ...]


def heats(rollouts: int) -> tuple[int, ...]:
    """Return after how many rollouts a candidate is judged: 1, 3, 9 and so on, at last all."""
    marks = [3**n for n in range(10) if 3**n < rollouts]
    return (*marks, rollouts)


class Race:
    """Estimates for one agent in one arena. Not ``heated``, all candidates take all rollouts."""

    def __init__(
        self, arena: Arena, root_seed: int, rollouts: int, worst: int, *, heated: bool = True
    ) -> None:
        if not 1 <= worst <= rollouts:
            raise ValueError(f"the worst {worst} of {rollouts} rollouts cannot be taken")
        self._arena, self._root_seed = arena, root_seed
        self._rollouts, self._worst = rollouts, worst
        self._marks = heats(rollouts) if heated else (rollouts,)

    def estimate(self, vectors: Vector, to_beat: Vector, keys: Sequence[Key]) -> Vector:
        """Return the estimates (k,) for vectors (k, P), from all rollouts where minus infinity is to beat."""
        seeds = np.array([draw_seeds(self._root_seed, key, self._rollouts) for key in keys])
        returns = np.full((len(vectors), self._rollouts), np.nan)
        estimates = np.full(len(vectors), -np.inf)
        racing = np.arange(len(vectors))
        done = 0
        for mark in self._marks:
            rows = np.repeat(racing, mark - done)
            found = self._arena.run(vectors[rows], seeds[racing, done:mark].ravel())
            returns[racing, done:mark] = found[:, :2].sum(axis=1).reshape(len(racing), -1)
            least = max(round(self._worst * mark / self._rollouts), 1)
            for row in racing:
                estimates[row] = mean_of_worst(returns[row, :mark].tolist(), least)
            racing = racing[(estimates[racing] > to_beat[racing]) | np.isneginf(to_beat[racing])]
            done = mark
            if not len(racing):
                break
        return estimates
