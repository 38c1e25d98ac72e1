"""Estimates of a return from several rollouts, with most candidates pruned after the first.

The paper takes N rollouts and averages the worst k. One rollout shows that most candidates are far worse than
their incumbent. So rollouts come in heats. A candidate that is not ahead after a heat, judged by the same
share of worst rollouts, is pruned, and its estimate is that of the heats it had. A candidate that stays in
all heats gets the paper's estimate. A search compares a candidate only with its incumbent, so racing loses
only candidates that would have won by late luck.
"""

from collections.abc import Sequence

import numpy as np

from sim.learn.robust import mean_of_worst
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
