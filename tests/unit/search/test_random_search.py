"""The random searches on toy objectives: what they may do, what they must decide, and that they repeat."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from kit.toy_search import DEFAULTS, LAYOUT, advance, returns, sphere

from sim.learn.search.algorithm1 import ESTIMATE_AFTER, Algorithm1, Scale
from sim.learn.search.published import Published

both = pytest.mark.parametrize("kind", [Published, Algorithm1])


def begin(kind, seed=0):
    return kind.begin(LAYOUT, DEFAULTS, np.random.default_rng(seed))


def judge(search, value):
    """Ask for one candidate (P,), give it a return, and hand it over."""
    candidate = search.ask()[0]
    search.tell([value])
    return candidate


@both
@given(seed=st.integers(0, 2**32), outcomes=st.lists(st.booleans(), min_size=1, max_size=150))
@settings(max_examples=30, deadline=None)
def test_candidates_stay_in_bounds_and_failures_leave_incumbent_unchanged(kind, seed, outcomes):
    search = begin(kind, seed)
    judge(search, 0.0)
    value = 0.0
    for success in outcomes:
        before = search.incumbent.copy()
        estimate = search.wants_estimate(search.adaptation)
        value += 1.0 if success else 0.0
        candidate = judge(search, value)  # the same value again is not strictly greater: a failure
        assert np.all((candidate >= LAYOUT.lower) & (candidate <= LAYOUT.upper))
        expected = (candidate if success and not estimate else before).tobytes()
        assert search.incumbent.tobytes() == expected
        candidate += 1.0  # the caller's array is its own
        assert search.incumbent.tobytes() == expected


@both
def test_any_value_that_is_not_better_is_a_failure(kind):
    full, raced = begin(kind), begin(kind)
    advance(full, 501, ahead=1)
    while raced.evaluations < 501:
        candidate = raced.ask()
        [value] = returns(sphere(candidate))
        estimate = raced.value is None or np.array_equal(candidate[0], raced.incumbent)
        raced.tell([value if estimate or value > raced.value else raced.value - 1e9])
    assert raced.state() == full.state()
    without_a_number = begin(kind)
    judge(without_a_number, 1.0)
    before = without_a_number.incumbent.copy()
    judge(without_a_number, float("nan"))
    assert np.array_equal(without_a_number.incumbent, before)


# -- Algorithm 1 -------------------------------------------------------------------------------------------


def test_scale_follows_success_and_failure_within_its_limits():
    first = Scale()
    greater, smaller = first.after_success(), first.after_failure()
    assert smaller.scale < first.scale < greater.scale
    assert greater.after_failure().scale == pytest.approx(first.scale)
    for _ in range(500):
        greater, smaller = greater.after_success(), smaller.after_failure()
    assert greater.after_success().scale == greater.scale
    assert smaller.after_failure().scale == smaller.scale > 0.0


def test_lucky_incumbent_is_estimated_anew():
    search = begin(Algorithm1)
    lucky = judge(search, 100.0)
    for _ in range(ESTIMATE_AFTER):
        assert not np.array_equal(judge(search, 1.0), lucky)
    assert np.array_equal(search.ask(8), lucky[None])
    search.tell([2.0])  # what it is really worth
    assert search.value == 2.0
    judge(search, 3.0)
    assert search.value == 3.0
