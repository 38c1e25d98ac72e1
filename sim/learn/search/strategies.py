"""The strategies by name."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from rover_ncp.circuit.policy import ParameterLayout
from sim.learn.search.algorithm1 import Algorithm1
from sim.learn.search.base import Search, Vector
from sim.learn.search.published import Published, shake

__all__ = ["STRATEGIES", "start_search"]

STRATEGIES: Mapping[str, Callable[[ParameterLayout, Vector, np.random.Generator], Search[Any]]] = {
    "published": Published,
    "algorithm1": Algorithm1,
}


def start_search(
    name: str, layout: ParameterLayout, defaults: Vector, generator: np.random.Generator
) -> Search[Any]:
    """Start a strategy from the defaults (P,), shaken with the same generator that it then searches with."""
    return STRATEGIES[name](layout, shake(layout, defaults, generator), generator)
