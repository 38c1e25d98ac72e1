"""The random searches on toy objectives: what they may do, what they must decide, and that they repeat."""

import json
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rover_ncp.circuit.circuit import BOUNDS, ParameterKind
from rover_ncp.circuit.policy import ParameterBlock, ParameterLayout, parking_policy
from rover_ncp.circuit.tap_withdrawal import parking_circuit
from sim.learn.search.algorithm1 import (
    ALPHA,
    ESTIMATE_AFTER,
    LEAST_SCALE,
    MOST_SCALE,
    START_SCALE,
    Algorithm1,
    Scale,
)
from sim.learn.search.base import Search
from sim.learn.search.published import RULES, Caps, Published, shake
from sim.learn.search.strategies import start_search

POLICY = parking_policy(parking_circuit())
LAYOUT = POLICY.layout()
DEFAULTS = POLICY.parameters()
WIDTH = LAYOUT.upper - LAYOUT.lower
GOAL = LAYOUT.lower + WIDTH * np.random.default_rng(99).random(LAYOUT.size)

SEARCHES = {"published": Published, "algorithm1": Algorithm1}
both = pytest.mark.parametrize("name", sorted(SEARCHES))


def sphere(vectors: np.ndarray) -> np.ndarray:
    """0 at the goal, falling with the squared distance as a fraction of each parameter's range."""
    return -np.sum(((vectors - GOAL) / WIDTH) ** 2, axis=1)


def begin(name: str, seed: int = 0) -> Search[Any]:
    search = start_search(name, LAYOUT, DEFAULTS, np.random.default_rng(seed))
    assert isinstance(search, SEARCHES[name])
    return search


def advance(
    search: Search[Any], iterations: int, returns: Callable[[np.ndarray], np.ndarray] = sphere, ahead: int = 1
) -> None:
    while search.value is None or search.iterations < iterations:
        left = max(iterations - search.iterations, 1)
        search.tell(returns(search.ask(min(ahead, left))))


def judge(search: Search[Any], value: float) -> np.ndarray:
    """Ask for one candidate (P,), give it a return, and hand it over."""
    candidate: np.ndarray = search.ask()[0]
    search.tell([value])
    return candidate


@both
def test_a_strategy_beats_random_sampling_by_far(name: str) -> None:
    iterations = 2000
    samples = LAYOUT.lower + WIDTH * np.random.default_rng(5).random((iterations + 1, LAYOUT.size))
    at_random = sphere(samples).max()
    for seed in range(3):
        search = begin(name, seed)
        start = float(sphere(search.incumbent[None])[0])
        advance(search, iterations)
        assert search.value is not None
        assert search.value > 0.25 * max(at_random, start)  # returns are negative: a quarter of the loss
        assert search.value == sphere(search.incumbent[None])[0]


@both
def test_a_seed_repeats_to_the_last_bit_and_another_does_not(name: str) -> None:
    runs = [begin(name, seed) for seed in (7, 7, 8)]
    for run in runs:
        advance(run, 300)
    assert runs[0].state() == runs[1].state()
    assert runs[0].value != runs[2].value


@both
@given(seed=st.integers(0, 2**32), outcomes=st.lists(st.booleans(), min_size=1, max_size=150))
@settings(max_examples=30, deadline=None)
def test_candidates_stay_in_bounds_and_a_failure_leaves_the_incumbent_untouched(
    name: str, seed: int, outcomes: list[bool]
) -> None:
    search = begin(name, seed)
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
        candidate += 1.0  # what the caller does to its own array is no concern of the search
        assert search.incumbent.tobytes() == expected


@both
@given(seed=st.integers(0, 2**32), ahead=st.lists(st.integers(1, 9), min_size=1, max_size=6))
@settings(max_examples=20, deadline=None)
def test_speculation_decides_as_one_by_one(name: str, seed: int, ahead: list[int]) -> None:
    one_by_one, speculating = begin(name, seed), begin(name, seed)
    advance(one_by_one, 400)
    asked = 0
    while speculating.iterations < 400 or speculating.value is None:
        count = min(ahead[asked % len(ahead)], max(400 - speculating.iterations, 1))
        speculating.tell(sphere(speculating.ask(count)))
        asked += 1
    assert speculating.state() == one_by_one.state()
    assert max(ahead) == 1 or asked < 401


@both
def test_any_value_that_is_not_better_counts_as_failure(name: str) -> None:
    full, raced = begin(name), begin(name)
    advance(full, 500)

    def stopped_early(vectors: np.ndarray) -> np.ndarray:
        values = sphere(vectors)
        if raced.value is None or np.array_equal(vectors[0], raced.incumbent):
            return values
        return np.where(values > raced.value, values, raced.value - 1e9)

    advance(raced, 500, stopped_early)
    assert raced.state() == full.state()
    without_a_number = begin(name)
    judge(without_a_number, 1.0)
    before = without_a_number.incumbent.copy()
    judge(without_a_number, float("nan"))
    assert np.array_equal(without_a_number.incumbent, before)


@both
@pytest.mark.parametrize("cut", [0, 1, 60, 133])
def test_a_state_that_went_through_json_continues_the_same_run(name: str, cut: int) -> None:
    whole, first, second = begin(name), begin(name), begin(name, seed=55)
    advance(whole, 300)
    advance(first, cut)
    second.restore(json.loads(json.dumps(first.state())))
    advance(second, 300)
    assert second.state() == whole.state()
    assert second.incumbent.tobytes() == whole.incumbent.tobytes()


@both
@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("incumbent", [0.0]),
        ("incumbent", [1e9] * LAYOUT.size),
        ("incumbent", [float("nan")] * LAYOUT.size),
        ("value", None),
        ("value", float("nan")),
        ("evaluations", "many"),
        ("adaptation", {}),
        ("adaptation", {"caps": [99, 3, 2, 2, 2], "failures": 0, "scale": 7.0}),
        ("generator", {"bit_generator": "MT19937"}),
    ],
)
def test_a_damaged_state_is_refused(name: str, key: str, value: object) -> None:
    search = begin(name)
    advance(search, 10)
    good = search.state()
    with pytest.raises((ValueError, KeyError, TypeError)):
        search.restore({**good, key: value})
    assert search.state() == good


def test_ask_and_tell_must_alternate() -> None:
    search = begin("published")
    with pytest.raises(ValueError, match="0 candidates wait"):
        search.tell([1.0])
    search.ask()
    with pytest.raises(RuntimeError, match="before tell"):
        search.ask()
    with pytest.raises(RuntimeError, match="between ask"):
        search.state()
    with pytest.raises(ValueError, match="no candidate could be compared"):
        search.tell([float("nan")])


def test_the_first_candidate_is_the_start_and_no_iteration() -> None:
    search = begin("published")
    start = search.incumbent.copy()
    assert np.array_equal(search.ask(5), start[None])
    assert search.tell([-3.0]) == 1
    assert (search.iterations, search.evaluations, search.value) == (0, 1, -3.0)


# -- the published variant ---------------------------------------------------------------------------------

LEAST, MOST = (4, 3, 2, 2, 2), (12, 8, 6, 6, 4)


@pytest.mark.parametrize(
    ("outcomes", "caps", "failures"),
    [
        ("", LEAST, 0),
        ("F" * 50, LEAST, 50),
        ("F" * 51, (5, 4, 3, 3, 3), 0),
        ("F" * 50 + "S", LEAST, 0),
        ("F" * 50 + "S" + "F" * 50, LEAST, 50),
        ("F" * 51 + "F" * 50, (5, 4, 3, 3, 3), 50),
        ("F" * 102, (6, 5, 4, 4, 4), 0),
        ("F" * 153, (7, 6, 5, 5, 4), 0),  # capacitance stops at 4
        ("F" * 51 * 4, (8, 7, 6, 6, 4), 0),
        ("F" * 51 * 5, (9, 8, 6, 6, 4), 0),
        ("F" * 51 * 8, MOST, 0),
        ("F" * 51 * 30, MOST, 0),
        ("F" * 51 * 8 + "S", (11, 7, 5, 5, 3), 0),
        ("F" * 51 * 8 + "SS", (10, 6, 4, 4, 2), 0),
        ("F" * 51 * 8 + "SSSF", (9, 5, 3, 3, 2), 1),
        ("F" * 51 * 8 + "S" * 20, LEAST, 0),
        ("F" * 51 + "S" + "F" * 51 + "F" * 7, (5, 4, 3, 3, 3), 7),
    ],
)
def test_the_caps_follow_the_published_rule(outcomes: str, caps: tuple[int, ...], failures: int) -> None:
    state = Caps(LEAST, MOST, LEAST)
    for outcome in outcomes:
        state = state.after_success() if outcome == "S" else state.after_failure()
    assert (state.caps, state.failures) == (caps, failures)


def test_search_adapts_its_caps_to_the_returns() -> None:
    search = begin("published")
    assert isinstance(search, Published)
    judge(search, 0.0)
    for _ in range(51):
        judge(search, -1.0)
    assert search.adaptation.caps == (5, 4, 3, 3, 3)
    judge(search, 1.0)
    assert search.adaptation.caps == LEAST


def test_changes_of_the_published_search_have_the_published_numbers_and_sizes() -> None:
    """Wide bounds, so that no clamp hides what was drawn; many entries, so that hardly any is hit twice."""
    size = 100_000
    blocks = tuple(
        ParameterBlock(kind, slice(i * size, (i + 1) * size), -1e6, 1e6)
        for i, kind in enumerate(list(ParameterKind)[:5])
    )
    layout = ParameterLayout(blocks)
    search = Published(layout, np.zeros(layout.size), np.random.default_rng(3))
    counts: list[list[int]] = [[] for _ in blocks]
    noise: list[list[float]] = [[] for _ in blocks]
    for _ in range(1500):
        candidate = search.propose(Caps(LEAST, MOST, LEAST), np.random.default_rng(len(counts[0])))
        for i, block in enumerate(blocks):
            moved = candidate[block.slice]
            moved = moved[moved != 0]
            counts[i].append(len(moved))
            noise[i].extend(moved.tolist())
    for i, block in enumerate(blocks):
        rule = RULES[block.kind]
        assert set(counts[i]) == set(range(LEAST[i] + 1))  # both ends included
        shares = np.bincount(counts[i]) / len(counts[i])
        assert np.abs(shares - 1 / (LEAST[i] + 1)).max() < 0.05
        # The variance of a normal whose deviation is uniform in [a, b] is the mean of its square.
        a, b = rule.low, rule.high
        expected = np.sqrt((a * a + a * b + b * b) / 3)
        assert np.std(noise[i]) == pytest.approx(expected, rel=0.08)


def test_every_entry_is_searched_and_gap_junctions_and_sensory_neurons_too() -> None:
    search = Published(LAYOUT, DEFAULTS, np.random.default_rng(0))
    moved = np.zeros(LAYOUT.size, bool)
    for _ in range(1000):
        moved |= search.propose(search.adaptation, np.random.default_rng(_)) != DEFAULTS
    held = moved | (LAYOUT.lower == DEFAULTS)
    assert held.all()
    assert LAYOUT.block(ParameterKind.WEIGHT).size == 30
    assert LAYOUT.block(ParameterKind.SIGMA).size == 28
    assert LAYOUT.block(ParameterKind.LEAK).size == LAYOUT.block(ParameterKind.CAPACITANCE).size == 12


def test_the_start_is_shaken_within_bounds_and_differs_between_agents() -> None:
    starts = [shake(LAYOUT, DEFAULTS, np.random.default_rng(seed)) for seed in range(20)]
    for start in starts:
        assert np.all((start >= LAYOUT.lower) & (start <= LAYOUT.upper))
        for block in LAYOUT.blocks:
            moved = np.count_nonzero(start[block.slice] != DEFAULTS[block.slice])
            assert 1 <= moved <= RULES[block.kind].start_changes
    assert len({start.tobytes() for start in starts}) == len(starts)
    assert DEFAULTS.tobytes() == POLICY.parameters().tobytes()


# -- Algorithm 1 -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("outcomes", "scale"),
    [
        ("S", START_SCALE * ALPHA),
        ("F", START_SCALE / ALPHA),
        ("SF", START_SCALE * ALPHA / ALPHA),
        ("SSF", START_SCALE * ALPHA),
        ("S" * 500, MOST_SCALE),
        ("F" * 500, LEAST_SCALE),
    ],
)
def test_the_scale_follows_success_and_failure(outcomes: str, scale: float) -> None:
    state = Scale()
    for outcome in outcomes:
        state = state.after_success() if outcome == "S" else state.after_failure()
    assert state.scale == pytest.approx(scale)


def test_a_lucky_incumbent_is_estimated_anew() -> None:
    search = begin("algorithm1")
    assert isinstance(search, Algorithm1)
    lucky = judge(search, 100.0)
    for _ in range(ESTIMATE_AFTER):
        assert not np.array_equal(judge(search, 1.0), lucky)
    assert np.array_equal(search.ask(8), lucky[None])
    search.tell([2.0])  # what it is really worth
    assert search.value == 2.0
    judge(search, 3.0)
    assert search.value == 3.0


def test_bounds_of_the_layout_are_the_papers() -> None:
    for block in LAYOUT.blocks:
        assert (block.lower, block.upper) == BOUNDS[block.kind][:2]
