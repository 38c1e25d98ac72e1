"""Searches: generators that propose parameter vectors and receive how their episodes ended.

    search = start_search(name, layout, defaults, rng, inert)
    batch = next(search)
    while True:
        batch = search.send(evaluated(batch))

The first batch is the start alone. A search knows vectors, their bounds and a random generator; neither
circuit nor simulator nor clock. It has no end: its caller stops it. A new search is a module of this folder
with a function ``search``, and its name in `SearchName`.
"""

from __future__ import annotations

from collections.abc import Generator
from importlib import import_module
from typing import TYPE_CHECKING, Literal, NamedTuple, TypeAlias

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from rover_ncp.circuit.policy import ParameterLayout

    Vector: TypeAlias = NDArray[np.float64]

SearchName: TypeAlias = Literal["gauss-newton", "published", "algorithm1"]
"""``some-name`` is ``search`` of the module ``some_name``, which is imported when its search begins."""


class Batch(NamedTuple):
    """Candidates that wait for their episodes."""

    vectors: Vector
    """(n, P) within bounds; the caller owns them."""
    to_beat: Vector
    """(n,) what a return must exceed to matter; an episode below may be truncated."""


class Scores(NamedTuple):
    """How the episodes of a batch ended."""

    returns: Vector
    """(n,)."""
    residuals: Vector
    """(n, C, 3) x, y and heading from each checkpoint, complete where an episode was not truncated."""


Search: TypeAlias = Generator[Batch, Scores, None]


def start_search(
    name: str, layout: ParameterLayout, defaults: Vector, rng: np.random.Generator, inert: NDArray[np.bool_]
) -> Search:
    """Begin a search at, or near, the defaults (P,); ``inert`` (P,) marks parameters without any effect."""
    module = import_module(f"sim.learn.search.{name.replace('-', '_')}")
    search: Search = module.search(layout, defaults, rng, inert)
    return search
