"""The strategies by name."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from rover_ncp.circuit.policy import ParameterLayout
from sim.learn.search.algorithm1 import Algorithm1
from sim.learn.search.base import Strategy, Vector
from sim.learn.search.gauss_newton import GaussNewton
from sim.learn.search.published import Published, shake
from sim.learn.search.unit_box import UnitBox

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
    """Start a strategy from the defaults (P,).

    The random searches start from defaults shaken with the same generator that they then search with, and
    change all parameters; ``inert`` (P,) marks those that have no effect, which the others leave alone.
    """
    if name == "gauss-newton":
        return GaussNewton(UnitBox(layout, defaults, inert), generator)
    random_search = Published if name == "published" else Algorithm1
    return random_search(layout, shake(layout, defaults, generator), generator)
