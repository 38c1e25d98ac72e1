"""CMA-ES (Hansen 2016, "The CMA evolution strategy: a tutorial", arXiv:1604.00772), for values with noise.

Equation numbers are the tutorial's; constants are its defaults, with negative weights. The arithmetic keeps
to one order of operations, and every generation draws from a random stream of its own: so a search is the
same on every machine, and goes on from its ``state`` as if it had never stopped.
"""

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rover_ncp.kernels.jit import kernel

FloatArray = NDArray[np.float64]

_SWEEPS = 30
"""The most sweeps of Jacobi's method: it converges quadratically, in eight or so."""
_LEAST_EIGENVALUE = 1e-20


class Constants(NamedTuple):
    """Constants of the tutorial's Table 1 for a dimension and population."""

    weights: FloatArray
    """(population,) of the places from the best to the worst; eq. 49 to 53."""
    parents: float
    """Effective number of those with positive weights, mu_eff."""
    c_sigma: float
    d_sigma: float
    c_c: float
    c_1: float
    c_mu: float
    length: float
    """Expected length of a normal vector."""


def default_population(dimension: int) -> int:
    """Return the tutorial's number of candidates, eq. 48."""
    return 4 + math.floor(3.0 * math.log(dimension))


class Cma:
    """Minimises a function of a vector (n,), unbounded; ask and tell by turns.

    ``spread`` stays within ``limits``, which may be changed between two generations.
    """

    def __init__(
        self,
        mean: FloatArray,
        spread: float,
        *,
        seed: int,
        population: int,
        limits: tuple[float, float] = (0.0, math.inf),
    ) -> None:
        self.mean: FloatArray = np.array(mean, np.float64)
        self.spread = spread
        self.generation = 0
        self.population = population
        self.limits = limits
        self._seed = seed
        size = len(self.mean)
        self._constants = _constants(size, population)
        self._covariance = np.eye(size)
        self._path, self._spread_path = np.zeros(size), np.zeros(size)
        self._axes, self._scales = np.eye(size), np.ones(size)
        self._drawn: FloatArray | None = None

    def ask(self) -> FloatArray:
        """Return the candidates (population, n) of this generation, the same however often it is asked."""
        stream = np.random.default_rng(np.random.SeedSequence(self._seed, spawn_key=(self.generation,)))
        normal = stream.standard_normal((self.population, len(self.mean)))
        self._drawn = _sheared(normal, self._axes, self._scales)
        return self.mean + self.spread * self._drawn

    def tell(self, values: FloatArray) -> None:
        """Take the values (population,) of what ``ask`` gave, in its order."""
        if self._drawn is None or len(values) != self.population:
            raise ValueError(f"tell needs the values of all {self.population} candidates, after ask")
        steps = self._drawn[np.argsort(np.asarray(values), kind="stable")]
        self._drawn = None
        self.generation += 1
        c = self._constants
        step = _weighted(np.maximum(c.weights, 0.0), steps)
        self.mean = self.mean + self.spread * step
        whitened = _whitened(step, self._axes, self._scales)
        # Eq. 43 to 45: the evolution paths and the spread.
        keep = 1.0 - c.c_sigma
        self._spread_path = (
            keep * self._spread_path + math.sqrt(c.c_sigma * (2.0 - c.c_sigma) * c.parents) * whitened
        )
        length = math.sqrt(_square(self._spread_path))
        self.spread *= math.exp(c.c_sigma / c.d_sigma * (length / c.length - 1.0))
        self.spread = min(max(self.spread, self.limits[0]), self.limits[1])
        settled = math.sqrt(1.0 - keep ** (2 * (self.generation + 1)))
        moves = length / settled < (1.4 + 2.0 / (len(self.mean) + 1.0)) * c.length
        self._path = (1.0 - c.c_c) * self._path
        if moves:
            self._path = self._path + math.sqrt(c.c_c * (2.0 - c.c_c) * c.parents) * step
        # Eq. 46 and 47: the covariance.
        lengths = np.array([_square(_whitened(row, self._axes, self._scales)) for row in steps])
        weights = np.where(c.weights >= 0.0, c.weights, c.weights * len(self.mean) / (lengths + 1e-8))
        lost = 0.0 if moves else c.c_c * (2.0 - c.c_c)
        keep = 1.0 + c.c_1 * lost - c.c_1 - c.c_mu * math.fsum(c.weights.tolist())
        _update(self._covariance, keep, c.c_1, self._path, c.c_mu * weights, steps)
        self._scales, self._axes = _eigen(self._covariance)

    def state(self) -> dict[str, Any]:
        """Return, between ``tell`` and ``ask``, all that follows depends on, as JSON can keep it."""
        return {
            "generation": self.generation,
            "spread": self.spread,
            "mean": self.mean.tolist(),
            "path": self._path.tolist(),
            "spread_path": self._spread_path.tolist(),
            "covariance": self._covariance.tolist(),
        }

    def restore(self, state: Mapping[str, Any]) -> None:
        """Go on from a ``state()``. Raises ValueError, KeyError or TypeError if it is not one of ours."""
        size = len(self.mean)
        shapes = {"mean": (size,), "path": (size,), "spread_path": (size,), "covariance": (size, size)}
        arrays = {name: np.array(state[name], np.float64) for name in shapes}
        generation, spread = int(state["generation"]), float(state["spread"])
        fits = all(arrays[name].shape == shape for name, shape in shapes.items())
        if not fits or generation < 0 or not 0.0 < spread < math.inf:
            raise ValueError(f"no state of a search in {size} dimensions")
        self.generation, self.spread, self.mean = generation, spread, arrays["mean"]
        self._path, self._spread_path = arrays["path"], arrays["spread_path"]
        self._covariance = arrays["covariance"]
        self._scales, self._axes = _eigen(self._covariance)
        self._drawn = None


def _constants(size: int, population: int) -> Constants:
    raw = [math.log((population + 1) / 2) - math.log(place + 1) for place in range(population)]
    good = [weight for weight in raw if weight > 0.0]
    bad = [weight for weight in raw if weight <= 0.0]
    parents = math.fsum(good) ** 2 / math.fsum(weight * weight for weight in good)
    others = math.fsum(bad) ** 2 / math.fsum(weight * weight for weight in bad)
    c_1 = 2.0 / ((size + 1.3) ** 2 + parents)
    c_mu = min(1.0 - c_1, 2.0 * (parents - 2.0 + 1.0 / parents) / ((size + 2.0) ** 2 + parents))
    least = min(1.0 + c_1 / c_mu, 1.0 + 2.0 * others / (parents + 2.0), (1.0 - c_1 - c_mu) / (size * c_mu))
    c_sigma = (parents + 2.0) / (size + parents + 5.0)
    return Constants(
        weights=np.array(
            [weight / math.fsum(good) for weight in good]
            + [least * weight / -math.fsum(bad) for weight in bad]
        ),
        parents=parents,
        c_sigma=c_sigma,
        d_sigma=1.0 + 2.0 * max(0.0, math.sqrt((parents - 1.0) / (size + 1.0)) - 1.0) + c_sigma,
        c_c=(4.0 + parents / size) / (size + 4.0 + 2.0 * parents / size),
        c_1=c_1,
        c_mu=c_mu,
        length=math.sqrt(size) * (1.0 - 1.0 / (4.0 * size) + 1.0 / (21.0 * size * size)),
    )


@kernel
def _sheared(normal: FloatArray, axes: FloatArray, scales: FloatArray) -> FloatArray:
    """Return rows (k, n) of the normal distribution that has these axes (rows) and scales."""
    result = np.zeros_like(normal)
    for k in range(normal.shape[0]):
        for axis in range(len(scales)):
            part = normal[k, axis] * scales[axis]
            for i in range(len(scales)):
                result[k, i] += part * axes[axis, i]
    return result


@kernel
def _whitened(vector: FloatArray, axes: FloatArray, scales: FloatArray) -> FloatArray:
    """Return C^(-1/2) times a vector (n,)."""
    result = np.zeros_like(vector)
    for axis in range(len(scales)):
        part = 0.0
        for i in range(len(scales)):
            part += axes[axis, i] * vector[i]
        part /= scales[axis]
        for i in range(len(scales)):
            result[i] += part * axes[axis, i]
    return result


@kernel
def _weighted(weights: FloatArray, rows: FloatArray) -> FloatArray:
    result = np.zeros(rows.shape[1])
    for k in range(len(weights)):
        for i in range(rows.shape[1]):
            result[i] += weights[k] * rows[k, i]
    return result


@kernel
def _square(vector: FloatArray) -> float:
    total = 0.0
    for part in vector:
        total += part * part
    return total


@kernel
def _update(  # noqa: PLR0917  # as the equation
    covariance: FloatArray,
    keep: float,
    c_1: float,
    path: FloatArray,
    weights: FloatArray,
    steps: FloatArray,
) -> None:
    for i in range(len(path)):
        for j in range(len(path)):
            covariance[i, j] = keep * covariance[i, j] + c_1 * (path[i] * path[j])
        for k in range(len(weights)):
            part = weights[k] * steps[k, i]
            for j in range(len(path)):
                covariance[i, j] += part * steps[k, j]
    for i in range(len(path)):
        for j in range(i):
            mean = 0.5 * (covariance[i, j] + covariance[j, i])
            covariance[i, j] = covariance[j, i] = mean


@kernel
def _eigen(covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the roots of the eigenvalues (n,) and the eigenvectors as rows (n, n), by Jacobi's method."""
    a = covariance.copy()
    size = len(a)
    axes = np.eye(size)
    for _ in range(_SWEEPS):
        off, whole = 0.0, 0.0
        for i in range(size):
            for j in range(size):
                whole += a[i, j] * a[i, j]
                off += a[i, j] * a[i, j] if i != j else 0.0
        if off <= 1e-24 * whole:
            break
        for p in range(size - 1):
            for q in range(p + 1, size):
                if a[p, q] == 0.0:
                    continue
                theta = (a[q, q] - a[p, p]) / (2.0 * a[p, q])
                tangent = 1.0 / (abs(theta) + math.sqrt(theta * theta + 1.0))
                if theta < 0.0:
                    tangent = -tangent
                cos = 1.0 / math.sqrt(tangent * tangent + 1.0)
                sin = tangent * cos
                for i in range(size):
                    row_p, row_q = a[p, i], a[q, i]
                    a[p, i], a[q, i] = cos * row_p - sin * row_q, sin * row_p + cos * row_q
                for i in range(size):
                    column_p, column_q = a[i, p], a[i, q]
                    a[i, p], a[i, q] = cos * column_p - sin * column_q, sin * column_p + cos * column_q
                for i in range(size):
                    axis_p, axis_q = axes[p, i], axes[q, i]
                    axes[p, i], axes[q, i] = cos * axis_p - sin * axis_q, sin * axis_p + cos * axis_q
    scales = np.empty(size)
    for i in range(size):
        scales[i] = math.sqrt(max(a[i, i], _LEAST_EIGENVALUE))
    return scales, axes
