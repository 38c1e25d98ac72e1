"""The searches by name."""

from collections.abc import Mapping

from sim.learn.search.algorithm1 import Algorithm1
from sim.learn.search.base import Strategy
from sim.learn.search.gauss_newton import GaussNewton
from sim.learn.search.published import Published

STRATEGIES: Mapping[str, type[Strategy]] = {
    "gauss-newton": GaussNewton,
    "published": Published,
    "algorithm1": Algorithm1,
}
