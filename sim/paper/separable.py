"""CMA-ES whose covariance is a diagonal (Ros and Hansen 2008): what it costs is linear in the dimension.

R. Ros, N. Hansen, "A simple modification in CMA-ES achieving linear time and space complexity", PPSN X.
Without rotations there is less to learn, so that the variances may change faster, by (n + 2) / 3.
"""

import math

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


class Separable:
    """Maximises a function of a vector (n,); ask and tell by turns. The same seed gives the same search."""

    def __init__(self, mean: FloatArray, spread: float, seed: int, population: int) -> None:
        self.mean: FloatArray = np.array(mean, np.float64)
        self.spread = spread
        self._generator = np.random.Generator(np.random.PCG64(seed))
        n = len(self.mean)
        parents = population // 2
        weights = math.log(population / 2 + 0.5) - np.log(np.arange(1, parents + 1))
        self._weights: FloatArray = weights / weights.sum()
        effective = 1.0 / float((self._weights**2).sum())
        faster = (n + 2) / 3
        self._effective = effective
        self._c_sigma = (effective + 2) / (n + effective + 5)
        self._d_sigma = 1 + 2 * max(0.0, math.sqrt((effective - 1) / (n + 1)) - 1) + self._c_sigma
        self._c_c = (4 + effective / n) / (n + 4 + 2 * effective / n)
        self._c_1 = min(faster * 2 / ((n + 1.3) ** 2 + effective), 0.5)
        c_mu = faster * 2 * (effective - 2 + 1 / effective) / ((n + 2) ** 2 + effective)
        self._c_mu = min(c_mu, 1 - self._c_1)
        self._length = math.sqrt(n) * (1 - 1 / (4 * n) + 1 / (21 * n * n))
        self._variances = np.ones(n)
        self._path, self._spread_path = np.zeros(n), np.zeros(n)
        self._generations = 0
        self._steps = np.zeros((population, n))

    def ask(self) -> FloatArray:
        """Return the candidates (population, n) of the next generation."""
        normal = self._generator.standard_normal(self._steps.shape)
        self._steps = normal * np.sqrt(self._variances)
        return self.mean + self.spread * self._steps

    def tell(self, values: FloatArray) -> None:
        """Take the values (population,) of the candidates."""
        best = np.argsort(-values, kind="stable")[: len(self._weights)]
        steps = self._steps[best]
        weights = self._weights[:, None]
        step = (weights * steps).sum(axis=0)
        self.mean = self.mean + self.spread * step
        self._generations += 1
        keep = 1 - self._c_sigma
        whitened = step / np.sqrt(self._variances)
        gain = math.sqrt(self._c_sigma * (2 - self._c_sigma) * self._effective)
        self._spread_path = keep * self._spread_path + gain * whitened
        length = math.sqrt(float((self._spread_path**2).sum()))
        settled = math.sqrt(1 - keep ** (2 * self._generations))
        moves = length / settled < (1.4 + 2 / (len(step) + 1)) * self._length
        self._path = (1 - self._c_c) * self._path
        if moves:
            self._path = self._path + math.sqrt(self._c_c * (2 - self._c_c) * self._effective) * step
        lost = 0.0 if moves else self._c_1 * self._c_c * (2 - self._c_c)
        self._variances = (
            (1 - self._c_1 - self._c_mu + lost) * self._variances
            + self._c_1 * self._path**2
            + self._c_mu * (weights * steps**2).sum(axis=0)
        )
        self.spread *= math.exp(self._c_sigma / self._d_sigma * (length / self._length - 1))
