"""What every search must do, whatever its rule, on toy objectives."""

import json
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from kit.toy_search import DEFAULTS, INERT, LAYOUT, SAMPLES, advance, returns, sphere

from sim.learn.search.base import dump_state
from sim.learn.search.strategies import SearchName, start_search

every = pytest.mark.parametrize("name", list(SearchName))


def begin(name, seed=0):
    return start_search(name, LAYOUT, DEFAULTS, np.random.default_rng(seed), INERT)


@every
def test_search_beats_random_sampling(name):
    for seed in range(3):
        search = begin(name, seed)
        start = float(returns(sphere(search.incumbent[None]))[0])
        advance(search, 2001)
        # Returns are negative: a quarter of the loss.
        assert search.value > 0.25 * max(float(returns(sphere(SAMPLES)).max()), start)
        assert search.value == returns(sphere(search.incumbent[None]))[0]


@every
def test_candidates_stay_in_bounds_and_the_caller_owns_them(name):
    search = begin(name, 3)
    seen = advance(search, 500)
    assert np.all((seen >= LAYOUT.lower) & (seen <= LAYOUT.upper))
    incumbent, candidates = search.incumbent.copy(), search.ask(3)
    candidates += 1.0
    assert search.incumbent.tobytes() == incumbent.tobytes()


@every
@given(cuts=st.sets(st.integers(1, 399), min_size=1, max_size=6), ahead=st.integers(1, 9))
@settings(max_examples=settings().max_examples // 8)
def test_a_seed_decides_and_pauses_portions_and_json_change_nothing(name, cuts, ahead):
    whole, search, other = begin(name), begin(name), begin(name, seed=8)
    for each in (whole, other):
        advance(each, 400, ahead=1)
    for end in [*sorted(cuts), 400]:
        advance(search, end, ahead=ahead)
        resumed = begin(name, seed=55)
        resumed.restore(json.loads(dump_state(search.state())))
        search = resumed
    assert dump_state(search.state()) == dump_state(whole.state()) != dump_state(other.state())


@every
def test_start_is_evaluated_first_and_is_no_iteration(name):
    search = begin(name)
    start = search.incumbent.copy()
    assert search.value is None
    assert np.array_equal(search.ask(5), start[None])
    assert np.isneginf(search.to_beat).all()
    assert search.tell(returns(sphere(start[None])), sphere(start[None])) == 1
    assert (search.iterations, search.evaluations) == (0, 1)
    assert search.value == returns(sphere(start[None]))[0]


@every
def test_ask_and_tell_must_alternate(name):
    search = begin(name)
    with pytest.raises(ValueError, match="0 candidates wait"):
        search.tell([1.0], sphere(DEFAULTS[None]))
    with pytest.raises(ValueError, match="at least one"):
        search.ask(0)
    search.ask()
    with pytest.raises(ValueError, match="1 candidates wait"):
        search.tell([1.0, 2.0], sphere(np.array([DEFAULTS, DEFAULTS])))
    with pytest.raises(ValueError, match=r"no candidate could be compared|not a number"):
        begin_asked(name).tell([math.nan], sphere(DEFAULTS[None]))
    for call in (search.ask, search.state):
        with pytest.raises(RuntimeError, match="ask"):
            call()


def begin_asked(name):
    search = begin(name)
    search.ask()
    return search
