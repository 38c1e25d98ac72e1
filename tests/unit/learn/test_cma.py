"""CMA-ES: what its tutorial promises, and that it repeats itself and goes on where it was."""

import json
from collections.abc import Callable

import numpy as np
import pytest

from sim.learn.search.cma import Cma, default_population

SIZE = 10
STRETCHED = 10.0 ** np.linspace(0.0, 2.0, SIZE)


def turned() -> np.ndarray:
    return np.linalg.qr(np.random.default_rng(0).normal(size=(SIZE, SIZE)))[0]


def ellipsoid(places: np.ndarray) -> np.ndarray:
    return np.square(STRETCHED * (places @ turned())).sum(axis=-1)


def begin(seed: int = 1) -> Cma:
    return Cma(np.ones(SIZE), 0.5, seed=seed, population=default_population(SIZE))


def test_it_learns_which_way_the_valley_runs() -> None:
    search = begin()
    for _ in range(600):
        search.tell(ellipsoid(search.ask()))
    assert ellipsoid(search.mean) < 1e-12 * ellipsoid(np.ones(SIZE))
    # Its distribution has the shape of the inverse of the ellipsoid's.
    directions = turned() @ np.diag(STRETCHED)
    covariance = np.array(search.state()["covariance"])
    round_again = directions.T @ covariance @ directions
    roots = np.linalg.eigvalsh(round_again)
    assert roots.max() / roots.min() < 30.0  # of 10,000 to begin with


def test_it_outruns_chance_with_noise() -> None:
    noise = np.random.default_rng(5)
    search = begin()
    for _ in range(150):
        values = ellipsoid(search.ask())
        search.tell(values * (1.0 + 0.3 * noise.standard_normal(len(values))))
    tried = noise.uniform(-1.0, 1.0, (150 * search.population, SIZE))
    assert ellipsoid(search.mean) < 0.5 * ellipsoid(tried).min()


def test_only_the_order_of_values_counts() -> None:
    searches = [begin(), begin()]
    for _ in range(20):
        for search, scale in zip(searches, (lambda y: y, np.log), strict=True):
            search.tell(scale(ellipsoid(search.ask())))
    assert np.array_equal(searches[0].mean, searches[1].mean)


def test_the_same_seed_is_the_same_search_and_another_is_not() -> None:
    first, again, other = begin(), begin(), begin(seed=2)
    for search in (first, again, other):
        for _ in range(5):
            search.tell(ellipsoid(search.ask()))
    assert np.array_equal(first.mean, again.mean)
    assert not np.array_equal(first.mean, other.mean)


def test_it_goes_on_from_its_state_to_the_last_bit() -> None:
    search, later = begin(), begin()
    for _ in range(7):
        search.tell(ellipsoid(search.ask()))
    later.restore(json.loads(json.dumps(search.state())))
    for _ in range(7):
        assert np.array_equal(search.ask(), later.ask())
        for each in (search, later):
            each.tell(ellipsoid(each.ask()))
    assert search.state() == later.state()


@pytest.mark.parametrize(("values", "spread"), [(ellipsoid, 0.2), (lambda places: -places[:, 0], 0.7)])
def test_the_spread_stays_within_its_limits(
    values: Callable[[np.ndarray], np.ndarray], spread: float
) -> None:
    search = Cma(np.ones(SIZE), 0.5, seed=1, population=10, limits=(0.2, 0.7))
    for _ in range(300):
        search.tell(values(search.ask()))
    assert search.spread == spread


def test_what_does_not_fit_is_refused() -> None:
    search = begin()
    with pytest.raises(ValueError, match="after ask"):
        search.tell(np.zeros(search.population))
    places = search.ask()
    with pytest.raises(ValueError, match="the values of all"):
        search.tell(np.zeros(len(places) - 1))
    with pytest.raises(ValueError, match="10 dimensions"):
        search.restore(begin().state() | {"mean": [0.0]})
    with pytest.raises(KeyError):
        search.restore({})
