"""The searches by name. A new one is a module with a class like these, and its line here."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from rover_ncp.circuit.policy import ParameterLayout
from sim.learn.search.algorithm1 import Algorithm1
from sim.learn.search.base import Strategy, Vector
from sim.learn.search.gauss_newton import GaussNewton
from sim.learn.search.published import Published

STRATEGIES: Mapping[str, type[Strategy]] = {
    "gauss-newton": GaussNewton,
    "published": Published,
    "algorithm1": Algorithm1,
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
