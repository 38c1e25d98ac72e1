"""The searches by name."""

from collections.abc import Mapping
from importlib import import_module

import numpy as np
from numpy.typing import NDArray

from rover_ncp.circuit.policy import ParameterLayout
from sim.learn.search import SearchName
from sim.learn.search.base import Strategy, Vector

STRATEGIES: Mapping[str, type[Strategy]] = {
    name.value: import_module(f"sim.learn.search.{name.replace('-', '_')}").SEARCH for name in SearchName
}


def start_search(
    name: str,
    layout: ParameterLayout,
    defaults: Vector,
    generator: np.random.Generator,
    inert: NDArray[np.bool_] | None = None,
) -> Strategy:
    """Begin a search at, or near, the defaults (P,); ``inert`` (P,) marks parameters without any effect."""
    return STRATEGIES[name].begin(layout, defaults, generator, inert)
