"""What every search must do, whatever its rule, on toy objectives; and the path of each."""

from typing import get_args

import numpy as np
import pytest
from kit.toy_search import LAYOUT, SAMPLES, ToySearch, returns, sphere

from sim.learn.search import SearchName
from sim.learn.search.algorithm1 import ESTIMATE_AFTER

every = pytest.mark.parametrize("name", get_args(SearchName))


@every
def test_search_beats_random_sampling(name):
    search = ToySearch(name)
    search.step()
    start = search.value
    search.advance(2001)
    # Returns are negative: a quarter of the loss.
    assert search.value > 0.25 * max(float(returns(sphere(SAMPLES)).max()), start)


@every
def test_start_comes_first_and_candidates_stay_in_bounds(name):
    search = ToySearch(name, 3)
    assert search.batch.vectors.shape == (1, LAYOUT.size)
    assert np.isneginf(search.batch.to_beat).all()
    seen = search.advance(500)
    assert np.all((seen >= LAYOUT.lower) & (seen <= LAYOUT.upper))


@every
def test_a_seed_decides(name):
    first, second, other = (ToySearch(name, seed) for seed in (0, 0, 8))
    seen = [each.advance(400) for each in (first, second, other)]
    assert np.array_equal(seen[0], seen[1])
    assert not np.array_equal(seen[0][-1], seen[2][-1])


@pytest.mark.parametrize("name", ["published", "algorithm1"])
def test_any_return_that_is_not_better_is_a_failure(name):
    full, raced = ToySearch(name), ToySearch(name)
    full.advance(501)
    while raced.tried < 501:
        (to_beat,) = raced.batch.to_beat
        residuals = sphere(raced.batch.vectors)
        values = returns(residuals)
        raced.tell(np.where(values > to_beat, values, to_beat - 1e9), residuals)
    assert raced.value == full.value
    assert np.array_equal(raced.best, full.best)


def test_lucky_incumbent_of_algorithm1_is_estimated_in_each_iteration_until_a_success():
    search = ToySearch("algorithm1")
    nothing = np.zeros((1, 1, 3))
    lucky = search.tell(np.array([100.0]), nothing)
    for _ in range(ESTIMATE_AFTER + 1):
        assert not np.array_equal(search.tell(np.array([1.0]), nothing), lucky)
    assert np.isneginf(search.batch.to_beat)
    assert np.array_equal(search.tell(np.array([2.0]), nothing), lucky)  # what it is really worth
    assert search.batch.to_beat == 2.0
    search.tell(np.array([1.0]), nothing)
    assert np.array_equal(search.tell(np.array([3.0]), nothing), lucky)
    search.tell(np.array([4.0]), nothing)
    assert search.batch.to_beat == 4.0


@pytest.mark.parametrize(
    ("name", "value"), [("published", -4.651421783769285), ("algorithm1", -3.4479997884436866)]
)
def test_path_of_a_seed_stays(name, value):
    """A decision that changes leads elsewhere within these candidates."""
    search = ToySearch(name, 12)
    search.advance(400)
    assert search.value == pytest.approx(value, rel=1e-9)
