"""What is added to the package of CMA-ES: exact states, limits of sigma, and refusals."""

import json

import numpy as np
import pytest

from sim.learn.search.cma import Cma, default_population

SIZE = 10
STRETCHED = 10.0 ** np.linspace(0.0, 2.0, SIZE)


def ellipsoid(places):
    turned = np.linalg.qr(np.random.default_rng(0).normal(size=(SIZE, SIZE)))[0]
    return np.square(STRETCHED * (places @ turned)).sum(axis=-1)


def begin():
    return Cma(np.ones(SIZE), 0.5, seed=1, population=default_population(SIZE))


def advance(search, generations):
    for _ in range(generations):
        search.tell(ellipsoid(search.ask()))
    return search


def test_search_continues_from_its_state_to_the_last_bit():
    search, later = advance(begin(), 7), begin()
    later.ask()
    later.restore(json.loads(json.dumps(search.state(), allow_nan=False)))
    for each in (search, later):
        advance(each, 7)
    assert search.state() == later.state()


@pytest.mark.parametrize(("values", "sigma"), [(ellipsoid, 0.2), (lambda places: -places[:, 0], 0.7)])
def test_sigma_stays_within_its_limits(values, sigma):
    search = Cma(np.ones(SIZE), 0.5, seed=1, population=10, limits=(0.2, 0.7))
    for _ in range(300):
        search.tell(values(search.ask()))
    assert search.sigma == sigma


def test_wrong_calls_are_rejected():
    search = begin()
    with pytest.raises(ValueError, match="after ask"):
        search.tell(np.zeros(search.population))
    places = search.ask()
    with pytest.raises(ValueError, match="the values of all"):
        search.tell(np.zeros(len(places) - 1))
