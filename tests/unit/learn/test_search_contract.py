"""What every search must do, whatever its rule, on toy objectives."""

import json
import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rover_ncp.circuit.compiled import dead_parameters
from rover_ncp.circuit.policy import parking_policy
from rover_ncp.circuit.policy_file import load_circuit
from sim.learn.search.base import Strategy, dump_state
from sim.learn.search.strategies import SearchName, start_search

POLICY = parking_policy(load_circuit("parking"))
LAYOUT = POLICY.layout()
DEFAULTS = POLICY.parameters()
WIDTH = LAYOUT.upper - LAYOUT.lower
INERT = dead_parameters(POLICY)
GOAL = np.where(INERT, DEFAULTS, LAYOUT.lower + WIDTH * np.random.default_rng(99).random(LAYOUT.size))
CHECKPOINTS = -(-LAYOUT.size // 3)

every = pytest.mark.parametrize("name", list(SearchName))


def residuals_of(vectors: np.ndarray) -> np.ndarray:
    """Residuals (n, 1, C, 3): the distance of each parameter from the goal, as a fraction of its range."""
    residuals = np.zeros((len(vectors), CHECKPOINTS * 3))
    residuals[:, : LAYOUT.size] = (vectors - GOAL) / WIDTH
    return residuals.reshape(len(vectors), 1, CHECKPOINTS, 3)


def returns_of(vectors: np.ndarray) -> np.ndarray:
    return -np.sum(residuals_of(vectors) ** 2, axis=(1, 2, 3))


def begin(name: str, seed: int = 0) -> Strategy:
    return start_search(name, LAYOUT, DEFAULTS, np.random.default_rng(seed), INERT)


def advance(search: Strategy, evaluations: int, ahead: int = 1000) -> np.ndarray:
    """Evaluate so many candidates; return all that were asked for (n, P)."""
    asked = [np.empty((0, LAYOUT.size))]
    while search.evaluations < evaluations:
        asked.append(search.ask(min(evaluations - search.evaluations, ahead, search.max_ahead)))
        assert len(search.to_beat) == len(asked[-1])
        search.tell(returns_of(asked[-1]), residuals_of(asked[-1]))
    return np.concatenate(asked)


@every
def test_search_beats_random_sampling(name: str) -> None:
    samples = LAYOUT.lower + WIDTH * np.random.default_rng(5).random((2000, LAYOUT.size))
    for seed in range(3):
        search = begin(name, seed)
        start = float(returns_of(search.incumbent[None])[0])
        advance(search, 2001)
        assert search.value is not None
        # Returns are negative: a quarter of the loss.
        assert search.value > 0.25 * max(float(returns_of(samples).max()), start)
        assert search.value == returns_of(search.incumbent[None])[0]


@every
def test_same_seed_gives_same_search(name: str) -> None:
    runs = [begin(name, seed) for seed in (7, 7, 8)]
    for run in runs:
        advance(run, 300)
    assert dump_state(runs[0].state()) == dump_state(runs[1].state())
    assert dump_state(runs[0].state()) != dump_state(runs[2].state())


@every
def test_candidates_stay_in_bounds_and_the_caller_owns_them(name: str) -> None:
    search = begin(name, 3)
    seen = advance(search, 500)
    assert np.all((seen >= LAYOUT.lower) & (seen <= LAYOUT.upper))
    incumbent, candidates = search.incumbent.copy(), search.ask(3)
    candidates += 1.0
    assert search.incumbent.tobytes() == incumbent.tobytes()


@every
@given(cuts=st.sets(st.integers(1, 399), min_size=1, max_size=6), ahead=st.integers(1, 9))
@settings(max_examples=15, deadline=None)
def test_pauses_portions_and_json_change_nothing(name: str, cuts: set[int], ahead: int) -> None:
    whole, search = begin(name), begin(name)
    advance(whole, 400, ahead=1)
    for end in [*sorted(cuts), 400]:
        advance(search, end, ahead)
        resumed = begin(name, seed=55)
        resumed.restore(json.loads(dump_state(search.state())))
        search = resumed
    assert dump_state(search.state()) == dump_state(whole.state())


@every
def test_start_is_evaluated_first_and_is_no_iteration(name: str) -> None:
    search = begin(name)
    start = search.incumbent.copy()
    assert search.value is None
    assert np.array_equal(search.ask(5), start[None])
    assert np.isneginf(search.to_beat).all()
    assert search.tell(returns_of(start[None]), residuals_of(start[None])) == 1
    assert (search.iterations, search.evaluations) == (0, 1)
    assert search.value == returns_of(start[None])[0]


@every
def test_ask_and_tell_must_alternate(name: str) -> None:
    search = begin(name)
    with pytest.raises(ValueError, match="0 candidates wait"):
        search.tell([1.0], residuals_of(DEFAULTS[None]))
    with pytest.raises(ValueError, match="at least one"):
        search.ask(0)
    search.ask()
    with pytest.raises(ValueError, match="1 candidates wait"):
        search.tell([1.0, 2.0], residuals_of(np.array([DEFAULTS, DEFAULTS])))
    with pytest.raises(ValueError, match=r"no candidate could be compared|not a number"):
        begin_asked(name).tell([math.nan], residuals_of(DEFAULTS[None]))
    for call in (search.ask, search.state):
        with pytest.raises(RuntimeError, match="ask"):
            call()


def begin_asked(name: str) -> Strategy:
    search = begin(name)
    search.ask()
    return search


DAMAGE: list[tuple[str, Any]] = [
    ("incumbent", [0.0]),
    ("incumbent", [1e9] * LAYOUT.size),
    ("incumbent", [math.nan] * LAYOUT.size),
    ("value", None),
    ("value", math.nan),
    ("evaluations", "many"),
    ("generator", {"bit_generator": "MT19937"}),
]
OF_RANDOM_SEARCHES: list[tuple[str, Any]] = [
    ("adaptation", {}),
    ("adaptation", {"caps": [99, 3, 2, 2, 2], "failures": 0, "scale": 7.0}),
]
OF_GAUSS_NEWTON: list[tuple[str, Any]] = [
    ("best", [0.0] * 3),
    ("best", "zz"),
    ("value", "best"),
    ("phase", "lunch"),
    ("batch", [[]]),
    ("values", [1.0] * 90),
    ("residuals", [0.0]),
    ("descent", {}),
    ("origin", {"point": [0.0], "value": -1.0}),
    ("race", {"batches": 1}),
]


@pytest.mark.parametrize("done", [10, 30, 100, 151])
@every
def test_damaged_state_is_rejected(name: str, done: int) -> None:
    search = begin(name)
    advance(search, done)
    good = dump_state(search.state())
    for key, value in DAMAGE + (OF_GAUSS_NEWTON if name == SearchName.GAUSS_NEWTON else OF_RANDOM_SEARCHES):
        with pytest.raises((ValueError, KeyError, TypeError)):
            search.restore({**json.loads(good), key: value})
        assert dump_state(search.state()) == good, key
