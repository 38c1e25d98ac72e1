"""CMA-ES of the ``cmaes`` package with what a training needs: an exact state, limits and whole populations.

Every generation draws from its own random stream. A search that is restored from its ``state`` therefore
continues with the same bits.
"""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from cmaes import CMA
from numpy.typing import NDArray

from rover_ncp.core.streams import Domain, integer_seed

FloatArray = NDArray[np.float64]

# ``cmaes`` offers no state but its pickle, which lacks the random generator and must not be read from a file.
_STATE = {
    "generation": "_g",
    "spread": "_sigma",
    "mean": "_mean",
    "covariance": "_C",
    "path": "_pc",
    "spread_path": "_p_sigma",
}


def default_population(dimension: int) -> int:
    """Return the default number of candidates (Hansen 2016, arXiv:1604.00772, eq. 48)."""
    return 4 + math.floor(3.0 * math.log(dimension))


class Cma:
    """Minimises a noisy function of a vector (n,), n > 1, without bounds.

    ``sigma``, the step size, is kept within ``limits``, which may be changed between generations.
    """

    def __init__(
        self,
        mean: FloatArray,
        sigma: float,
        *,
        seed: int,
        population: int,
        limits: tuple[float, float] = (0.0, math.inf),
    ) -> None:
        self.population = population
        self.limits = limits
        self._seed = seed
        self._cma = CMA(np.array(mean, np.float64), sigma, population_size=population)
        self._asked: FloatArray | None = None

    @property
    def generation(self) -> int:
        """Generations done."""
        return int(self._cma.generation)

    @property
    def mean(self) -> FloatArray:
        """(n,) mean of the distribution."""
        mean: FloatArray = self._cma.mean.copy()
        return mean

    @property
    def sigma(self) -> float:
        """Step size sigma."""
        return float(self._cma._sigma)

    def ask(self) -> FloatArray:
        """Return the candidates (population, n) of this generation."""
        self._cma.reseed_rng(integer_seed(self._seed, Domain.CMA_GENERATION, self.generation))
        self._asked = np.array([self._cma.ask() for _ in range(self.population)])
        return self._asked

    def tell(self, values: FloatArray) -> None:
        """Take the values (population,) of the candidates in the order of ``ask``; NaN is the worst."""
        if self._asked is None or len(values) != self.population:
            raise ValueError(f"tell needs the values of all {self.population} candidates, after ask")
        ranked = np.where(np.isnan(values), math.inf, values)
        self._cma.tell(list(zip(self._asked, ranked.tolist(), strict=True)))
        self._cma._sigma = min(max(self.sigma, self.limits[0]), self.limits[1])
        self._asked = None

    def state(self) -> dict[str, Any]:
        """Return the state between ``tell`` and ``ask`` as numbers and lists."""
        return {key: np.asarray(getattr(self._cma, name)).tolist() for key, name in _STATE.items()}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Continue from a ``state()``."""
        for key, name in _STATE.items():
            value = np.array(state[key], np.asarray(getattr(self._cma, name)).dtype)
            setattr(self._cma, name, value if value.ndim else value.item())
        # The eigenvalues are those of another covariance.
        self._cma._D = self._cma._B = None
        self._asked = None
