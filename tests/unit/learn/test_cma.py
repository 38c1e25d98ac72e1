"""CMA-ES by its package: it learns the shape of a valley, repeats itself and continues from its state."""

import json
from collections.abc import Callable

import numpy as np
import pytest

from sim.learn.search.cma import Cma, default_population

SIZE = 10
STRETCHED = 10.0 ** np.linspace(0.0, 2.0, SIZE)
kinds = pytest.mark.parametrize("separable", [False, True])


def ellipsoid(places: np.ndarray, separable: bool = False) -> np.ndarray:
    turned = np.linalg.qr(np.random.default_rng(0).normal(size=(SIZE, SIZE)))[0]
    return np.square(STRETCHED * (places if separable else places @ turned)).sum(axis=-1)


def begin(separable: bool = False, seed: int = 1) -> Cma:
    population = default_population(SIZE)
    return Cma(np.ones(SIZE), 0.5, seed=seed, population=population, separable=separable)


def advance(search: Cma, generations: int, separable: bool) -> Cma:
    for _ in range(generations):
        search.tell(ellipsoid(search.ask(), separable))
    return search


@kinds
def test_search_descends_a_narrow_valley(separable: bool) -> None:
    search = advance(begin(separable), 600, separable)
    assert ellipsoid(search.mean, separable) < 1e-12 * ellipsoid(np.ones(SIZE), separable)


def test_search_beats_random_sampling_under_noise() -> None:
    noise = np.random.default_rng(5)
    search = begin()
    for _ in range(150):
        values = ellipsoid(search.ask())
        search.tell(values * (1.0 + 0.3 * noise.standard_normal(len(values))))
    tried = noise.uniform(-1.0, 1.0, (150 * search.population, SIZE))
    assert ellipsoid(search.mean) < 0.5 * ellipsoid(tried).min()


def test_only_order_of_values_counts_and_nan_is_worst() -> None:
    plain, other = begin(), begin()
    for _ in range(20):
        values = ellipsoid(plain.ask())
        plain.tell(values)
        values = np.log(ellipsoid(other.ask()))
        values[values.argmax()] = np.nan
        other.tell(values)
    assert np.array_equal(plain.mean, other.mean)


@kinds
def test_same_seed_gives_same_search(separable: bool) -> None:
    first, again, other = (advance(begin(separable, seed), 5, separable) for seed in (1, 1, 2))
    assert np.array_equal(first.mean, again.mean)
    assert not np.array_equal(first.mean, other.mean)


@kinds
def test_search_continues_from_its_state_to_the_last_bit(separable: bool) -> None:
    search, later = advance(begin(separable), 7, separable), begin(separable)
    later.ask()
    later.restore(json.loads(json.dumps(search.state(), allow_nan=False)))
    for each in (search, later):
        advance(each, 7, separable)
    assert search.state() == later.state()


@pytest.mark.parametrize(("values", "spread"), [(ellipsoid, 0.2), (lambda places: -places[:, 0], 0.7)])
def test_spread_stays_within_its_limits(values: Callable[[np.ndarray], np.ndarray], spread: float) -> None:
    search = Cma(np.ones(SIZE), 0.5, seed=1, population=10, limits=(0.2, 0.7))
    for _ in range(300):
        search.tell(values(search.ask()))
    assert search.spread == spread


def test_wrong_calls_and_states_are_rejected() -> None:
    search = begin()
    with pytest.raises(ValueError, match="after ask"):
        search.tell(np.zeros(search.population))
    places = search.ask()
    with pytest.raises(ValueError, match="the values of all"):
        search.tell(np.zeros(len(places) - 1))
    for damage in ({"mean": [0.0]}, {"spread": -1.0}, {"generation": "many"}):
        with pytest.raises(ValueError, match=r"dimensions|no generation|invalid literal"):
            search.restore(begin().state() | damage)
    with pytest.raises(KeyError):
        search.restore({})
