"""The interface of all searches: ``ask`` for candidates, ``tell`` their returns.

A search knows vectors, their bounds and a random generator; neither circuit nor simulator nor clock. Nothing
else may happen between ``ask`` and ``tell``.
"""

import json
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from rover_ncp.circuit.policy import ParameterLayout

Vector = NDArray[np.float64]
Seeds = NDArray[np.uint64]

SearchState = Mapping[str, Any]
"""A search between ``tell`` and ``ask`` as plain values, arrays, lists and mappings."""


def draw_seeds(root: int, key: Sequence[int], count: int) -> Seeds:
    """Return the seeds (count,) of a stream."""
    sequence = np.random.SeedSequence(root, spawn_key=tuple(key))
    return sequence.generate_state(count, np.uint64).astype(np.uint64, copy=False)


def dump_state(state: SearchState) -> str:
    """Return a state as JSON, arrays as nested lists; it keeps every bit."""
    return json.dumps(state, allow_nan=False, default=np.ndarray.tolist)


class Strategy(Protocol):
    """A search that maximises a return."""

    max_ahead: ClassVar[int]
    """How many candidates to ask for at once, at most."""
    speculates: ClassVar[bool]
    """Whether ``tell`` discards those after the first success, of several asked for at once."""

    @classmethod
    def begin(
        cls,
        layout: ParameterLayout,
        defaults: Vector,
        generator: np.random.Generator,
        inert: NDArray[np.bool_] | None = None,
    ) -> Self:
        """Begin at, or near, the defaults (P,); ``inert`` (P,) marks parameters without any effect."""

    @property
    def value(self) -> float | None:
        """The incumbent's return; None before the first ``tell``."""

    @property
    def evaluations(self) -> int:
        """Returns taken."""

    @property
    def incumbent(self) -> Vector:
        """The best vector (P,) so far; before there is any, that which will be evaluated first."""

    @property
    def iterations(self) -> int:
        """Returns taken after the first one."""

    @property
    def to_beat(self) -> Vector:
        """(n,) what the returns of the candidates handed out must exceed to matter."""

    def ask(self, count: int = 1) -> Vector:
        """Return candidates (n, P), 1 <= n <= count."""

    def tell(self, values: Sequence[float] | Vector, residuals: Vector | None = None) -> int:
        """Take the returns (n,), and residuals (n, 1, C, 3) if needed; return how many of them counted."""

    def state(self) -> SearchState:
        """Return all that the next ``ask`` depends on."""

    def restore(self, state: SearchState) -> None:
        """Continue from a ``state()`` of this search, also one that JSON has kept. Nothing checks it."""
