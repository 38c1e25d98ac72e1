"""The searches by name: a new one is a module of this folder and a line of `SearchName`."""

from __future__ import annotations

from enum import StrEnum
from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from rover_ncp.circuit.policy import ParameterLayout
    from sim.learn.search.base import Strategy, Vector


class SearchName(StrEnum):
    """The names that ``--search`` takes; ``some-name`` is ``SEARCH`` of the module ``some_name``.

    That module is imported when its search begins: ``--help`` needs the names alone.
    """

    GAUSS_NEWTON = "gauss-newton"
    PUBLISHED = "published"
    ALGORITHM1 = "algorithm1"


def start_search(
    name: str,
    layout: ParameterLayout,
    defaults: Vector,
    generator: np.random.Generator,
    inert: NDArray[np.bool_] | None = None,
) -> Strategy:
    """Begin a search at, or near, the defaults (P,); ``inert`` (P,) marks parameters without any effect."""
    search: type[Strategy] = import_module(f"sim.learn.search.{name.replace('-', '_')}").SEARCH
    return search.begin(layout, defaults, generator, inert)
