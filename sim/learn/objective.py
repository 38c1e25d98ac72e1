"""The objective that a search maximises: the return of one rollout, or an estimate from several.

Section IV of the paper: N rollouts, of which all, or the worst k, are averaged. Rollouts that are random
take a seed each from the stream (agent, evaluation), so that a candidate's estimate depends neither on the
process that computes it nor on its neighbours in the batch.
"""

import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

from rover_ncp.core.errors import UsageError
from sim.learn.search.base import Vector

if TYPE_CHECKING:
    from sim.learn.flow import Flow

Seeds = NDArray[np.uint64]
Key = tuple[int, ...]


class Objective(Protocol):
    """Estimates returns in bulk."""

    def estimate(self, vectors: Vector, to_beat: Vector, keys: Sequence[Key]) -> Vector:
        """Return the estimates (k,) for vectors (k, P).

        Where an estimate does not exceed ``to_beat`` (k,), any other value that does not will do; minus
        infinity there asks for the estimate itself. ``keys`` name each one's random stream.
        """

    def trace(self, vectors: Vector) -> tuple[Vector, Vector]:
        """Return the returns (k,) of vectors (k, P), and the misses (k, E, C, 3) they are made of.

        E episodes of C checkpoints each; a return is minus the sum of the squares, averaged over episodes.
        """


class Deterministic:
    """A deterministic task: one rollout gives the return.

    ``returns`` takes vectors (k, P) and the thresholds (k,) below which a rollout may stop; it gives (k,).
    ``traces`` is the result of ``trace``, for strategies that need it. ``stream``, if there is one, opens a
    flow that does both for so many agents.
    """

    def __init__(
        self,
        returns: Callable[[Vector, Vector], Vector],
        traces: Callable[[Vector], tuple[Vector, Vector]] | None = None,
        stream: Callable[[int], "Flow"] | None = None,
    ) -> None:
        self._returns = returns
        self._traces = traces
        self.stream = stream

    def estimate(self, vectors: Vector, to_beat: Vector, keys: Sequence[Key]) -> Vector:
        """Return the returns (k,) of vectors (k, P)."""
        return self._returns(vectors, to_beat)

    def trace(self, vectors: Vector) -> tuple[Vector, Vector]:
        """Return the returns (k,) of vectors (k, P), and the misses (k, E, C, 3) they are made of."""
        if self._traces is None:
            raise TypeError("this objective knows only returns")
        return self._traces(vectors)


class Sampled:
    """A task with chance: N rollouts each, and the mean of the worst k of them (all of them if k = N).

    ``returns`` takes vectors (n, P) and seeds (n,) and gives returns (n,).
    """

    def __init__(
        self, returns: Callable[[Vector, Seeds], Vector], root_seed: int, rollouts: int, worst: int
    ) -> None:
        if not 1 <= worst <= rollouts:
            raise ValueError(f"the worst {worst} of {rollouts} rollouts cannot be taken")
        self._returns = returns
        self._root_seed = root_seed
        self._rollouts = rollouts
        self._worst = worst

    def estimate(self, vectors: Vector, to_beat: Vector, keys: Sequence[Key]) -> Vector:
        """Return the estimates (k,) for vectors (k, P), each from its own N seeds."""
        seeds = [
            np.random.SeedSequence(self._root_seed, spawn_key=key).generate_state(self._rollouts, np.uint64)
            for key in keys
        ]
        returns = self._returns(np.repeat(vectors, self._rollouts, axis=0), np.concatenate(seeds))
        rows = returns.reshape(len(vectors), self._rollouts)
        return np.array([mean_of_worst(row.tolist(), self._worst) for row in rows])

    def trace(self, vectors: Vector) -> tuple[Vector, Vector]:
        """Raise UsageError: between two estimates chance moves the misses more than any parameter does."""
        raise UsageError("a search that needs the misses cannot estimate from random rollouts")


def mean_of_worst(returns: Sequence[float], worst: int) -> float:
    """Return the mean of the ``worst`` lowest returns, the same bits in whatever order they come."""
    return math.fsum(sorted(returns)[:worst]) / worst
