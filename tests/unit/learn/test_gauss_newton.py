"""The Gauss-Newton search on toy objectives: what it measures and decides, and that it repeats to the bit."""

import json
import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rover_ncp.circuit.compiled import inert_parameters
from rover_ncp.circuit.policy import parking_policy
from rover_ncp.circuit.tap_withdrawal import parking_circuit
from sim.learn.search import descent as descents
from sim.learn.search import gauss_newton
from sim.learn.search.descent import FIRST_DAMPING, WINDOW, Descent, Outcome
from sim.learn.search.gauss_newton import HOPS, PATIENCE, PROBE, SAMPLES, GaussNewton
from sim.learn.search.packed import pack
from sim.learn.search.unit_box import BY_LOGARITHM, UnitBox

POLICY = parking_policy(parking_circuit())
LAYOUT = POLICY.layout()
DEFAULTS = POLICY.parameters()
WIDTH = LAYOUT.upper - LAYOUT.lower
INERT = inert_parameters(POLICY)
GOAL = np.where(INERT, DEFAULTS, LAYOUT.lower + WIDTH * np.random.default_rng(99).random(LAYOUT.size))
CHECKPOINTS = -(-LAYOUT.size // 3)

Toy = Any


def sphere(vectors: np.ndarray) -> np.ndarray:
    """Misses (n, 1, C, 3): how far each parameter is from the goal, as a fraction of its range."""
    misses = np.zeros((len(vectors), CHECKPOINTS * 3))
    misses[:, : LAYOUT.size] = (vectors - GOAL) / WIDTH
    return misses.reshape(len(vectors), 1, CHECKPOINTS, 3)


def valley(vectors: np.ndarray) -> np.ndarray:
    """Misses of a bent, narrow valley (Rosenbrock's) between each two parameters, with other hollows."""
    unit = 3.0 * (vectors - LAYOUT.lower) / WIDTH - 1.0
    unit[:, INERT] = 1.0
    misses = np.zeros((len(vectors), CHECKPOINTS, 3))
    a, b = unit[:, 0 : 2 * CHECKPOINTS : 2], unit[:, 1 : 2 * CHECKPOINTS : 2]
    misses[:, : a.shape[1], 0] = 1.0 - a
    misses[:, : b.shape[1], 1] = 3.0 * (b - a[:, : b.shape[1]] ** 2)
    misses[:, : a.shape[1], 2] = 0.2 * np.sin(5.0 * (a - 1.0))
    return misses[:, None]


def returns(misses: np.ndarray) -> np.ndarray:
    return -np.sum(misses**2, axis=(1, 2, 3))


def begin(seed: int = 0) -> GaussNewton:
    return GaussNewton(UnitBox(LAYOUT, DEFAULTS, INERT), np.random.default_rng(seed))


def advance(search: GaussNewton, evaluations: int, toy: Toy = sphere, portion: int = 1000) -> None:
    while search.evaluations < evaluations:
        misses = toy(search.ask(min(portion, evaluations - search.evaluations)))
        search.tell(returns(misses), misses)


def batch(search: GaussNewton, toy: Toy = sphere) -> np.ndarray:
    """Give a search all it asks for; return the candidates (n, P)."""
    vectors = search.ask(1000)
    misses = toy(vectors)
    assert search.tell(returns(misses), misses) == len(vectors)
    return vectors


# -- the search --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("toy", [sphere, valley])
def test_it_beats_random_sampling_by_far(toy: Toy) -> None:
    samples = LAYOUT.lower + WIDTH * np.random.default_rng(5).random((2000, LAYOUT.size))
    at_random = float(returns(toy(samples)).max())
    for seed in range(3):
        search = begin(seed)
        advance(search, 2000, toy)
        assert search.value is not None
        assert search.value > 0.25 * at_random  # returns are negative: a quarter of the loss
        assert search.value == returns(toy(search.incumbent[None]))[0]


def test_on_straight_misses_a_single_descent_arrives() -> None:
    box = UnitBox(LAYOUT, DEFAULTS, INERT)
    target = np.random.default_rng(3).uniform(0.2, 0.8, box.size)
    goal = box.vectors(target[None])[0]

    def straight(vectors: np.ndarray) -> np.ndarray:
        unit = (vectors - LAYOUT.lower) / WIDTH
        for kind in BY_LOGARITHM:
            at = LAYOUT.block(kind).slice
            unit[:, at] = np.log(vectors[:, at] / LAYOUT.lower[at]) / np.log(
                LAYOUT.upper[at] / LAYOUT.lower[at]
            )
        misses = np.zeros((len(vectors), CHECKPOINTS * 3))
        misses[:, : box.size] = unit[:, box.free] - target
        return misses.reshape(len(vectors), 1, CHECKPOINTS, 3)

    search = begin()
    advance(search, 1 + SAMPLES + box.size + 60, straight)
    assert search.incumbent == pytest.approx(goal, rel=1e-4, abs=1e-4)


def test_a_seed_repeats_to_the_last_bit_and_another_does_not() -> None:
    runs = [begin(seed) for seed in (7, 7, 8)]
    for run in runs:
        advance(run, 400, valley)
    assert runs[0].state() == runs[1].state()
    assert runs[0].value != runs[2].value


@given(portions=st.lists(st.integers(1, 60), min_size=1, max_size=8))
@settings(max_examples=15, deadline=None)
def test_portions_and_json_change_nothing(portions: list[int]) -> None:
    whole, search = begin(), begin()
    advance(whole, 500, valley)
    for portion in portions * 500:
        if search.evaluations == 500:
            break
        advance(search, min(search.evaluations + portion, 500), valley)
        resumed = begin(seed=55)
        resumed.restore(json.loads(json.dumps(search.state(), allow_nan=False)))
        search = resumed
    assert search.state() == whole.state()


def test_the_untuned_start_comes_first_and_is_no_iteration() -> None:
    search = begin()
    first = batch(search)
    assert first[0] == pytest.approx(DEFAULTS, rel=1e-12)
    assert len(first) == 1
    assert (search.iterations, search.evaluations) == (0, 1)
    assert search.value == returns(sphere(first))[0]


def test_samples_then_all_slopes_then_a_step_and_a_probe_and_two_steps_where_it_is_close() -> None:
    search = begin()
    batch(search)
    assert len(batch(search)) == SAMPLES
    probes = batch(search)
    moved = probes != np.median(probes, axis=0)
    assert moved[:, ~INERT].sum(axis=0).tolist() == [1] * len(probes)
    assert not moved[:, INERT].any()
    sizes = [len(batch(search)) for _ in range(10)]
    assert search.evaluations == 1 + SAMPLES + len(probes) + sum(sizes)
    far = sizes.count(2)
    assert 0 < far < 10
    assert sizes == [2] * far + [3] * (10 - far)


def test_every_candidate_lies_in_bounds_and_inert_parameters_are_left_alone() -> None:
    search = begin(3)
    seen = np.concatenate([batch(search, valley) for _ in range(400)])
    assert np.all((seen >= LAYOUT.lower) & (seen <= LAYOUT.upper))
    assert np.all(seen[:, INERT] == DEFAULTS[INERT])
    assert np.all(np.ptp(seen[:, ~INERT], axis=0) > 0)


def hopeless(vectors: np.ndarray) -> np.ndarray:
    return np.ones((len(vectors), 1, CHECKPOINTS, 3)) + 1e-6 * np.sin(1e3 * vectors[:, :1, None, None])


def test_a_descent_that_gains_nothing_makes_room_for_new_samples() -> None:
    search = begin()
    sizes = [len(batch(search, hopeless)) for _ in range(WINDOW + 6)]
    free = LAYOUT.size - int(INERT.sum())
    far = sizes.pop(WINDOW + 3)  # nothing has an effect, near or far
    assert sizes == [1, SAMPLES, free, *[2] * WINDOW, SAMPLES, free]
    assert descents.MOST_SILENT * len(descents.FAR) <= far <= 2 * descents.MOST_SILENT * len(descents.FAR)


def stalled(survives: bool = True) -> Descent:
    """A descent at a point of four parameters, of which the second and the last have no slope."""
    slopes = np.full((4, 6), 0.5)
    slopes[[1, 3]] = 0.0
    at = Outcome(np.array([0.5, 0.5, 0.5, 0.98]), -0.6, np.full((1, 2, 3), math.sqrt(0.1)))
    descent = Descent(at, survives, False, slopes, 1e3, [])
    descent.scores = [descent.score(at)]
    return descent


@pytest.mark.parametrize(
    ("value", "gain", "goes_on"),
    [(-0.5, 0.024, False), (-0.5, 0.026, True), (-0.09, 0.0008, False), (-0.09, 0.001, True)],
)
def test_a_crawl_ends_sooner_far_from_the_goal_than_close_to_it(
    value: float, gain: float, goes_on: bool
) -> None:
    misses = np.zeros((1, 22, 3))
    misses[0, 0, 0] = math.sqrt(-value)
    descent = Descent(Outcome(np.zeros(4), value, misses), False, False, np.zeros((4, 66)), 0.1, [])
    descent.scores = [value - gain] + [value] * (WINDOW - 1)
    worse = Outcome(np.full(4, 0.01), value - 1.0, misses * 2.0)
    assert descent.take([worse]) == goes_on


def test_only_silent_parameters_are_moved_far_and_stay_in_the_box() -> None:
    descent = stalled()
    assert descent.silent.tolist() == [1, 3]
    moves = descent.far_probes() - descent.at.point
    assert not moves[:, [0, 2]].any()
    assert sorted(moves[moves[:, 1] != 0, 1]) == pytest.approx(
        sorted([*descents.FAR, *np.negative(descents.FAR)])
    )
    assert sorted(-moves[moves[:, 3] != 0, 3]) == pytest.approx(descents.FAR)
    assert ((moves != 0).sum(axis=1) == 1).all()


def test_a_descent_goes_on_from_the_largest_effect_at_a_fair_price() -> None:
    descent = stalled()

    def probe(miss: float) -> Outcome:
        """An outcome whose last miss, of 0.32, is that much greater."""
        misses = descent.at.misses.copy()
        misses[0, 1, 2] += miss
        return Outcome(np.full(4, miss), -float((misses**2).sum()), misses)

    price = descents.FAIR_PRICE * (2 - descent.scores[-1])
    dear, fair, slight, none = probe(3.0), probe(0.02), probe(-0.011), probe(descents.SILENT / 2)
    assert descent.scores[-1] - descent.score(dear) > price > descent.scores[-1] - descent.score(fair) > 0
    assert not descent.wake([dear, none])
    assert descent.scores[-1] == descent.score(descent.at)
    assert descent.wake([slight, dear, fair, none])
    assert descent.at is fair
    assert descent.scores == [descent.score(fair)]
    assert (descent.damping, descent.woken) == (FIRST_DAMPING, 2)


def test_a_motor_that_fell_silent_is_woken() -> None:
    free = np.flatnonzero(~INERT)

    def motor(vectors: np.ndarray) -> np.ndarray:
        """Misses that eight parameters could end, each from 3.5 deviations of the samples on."""
        unit = (vectors - LAYOUT.lower) / WIDTH
        start = (DEFAULTS - LAYOUT.lower) / WIDTH
        acts = np.maximum((unit - start)[:, free[:8]] - 0.35, 0.0).sum(axis=1)
        misses = np.zeros((len(vectors), CHECKPOINTS, 3))
        misses[:, :4, 0] = (1.0 - 3.0 * acts)[:, None]
        misses[:, :, 1] = (unit - start)[:, free[20:21]] - 0.01
        return misses[:, None]

    search = begin()
    sizes = []
    while search.value is None or search.value < -1.0:
        sizes.append(len(batch(search, motor)))
        assert search.evaluations < 3000
    assert max(sizes.count(SAMPLES), sizes.count(HOPS)) == 1


def test_a_search_that_is_close_hops_from_its_best_point() -> None:
    search = begin()
    near = DEFAULTS + 0.01 * WIDTH

    def close(vectors: np.ndarray) -> np.ndarray:
        """Close everywhere, closest at the untuned start, and nowhere any better."""
        away = np.abs((vectors - DEFAULTS) / WIDTH).sum(axis=1) > 1e-9
        return np.full((len(vectors), 1, CHECKPOINTS, 3), 0.04) * (1 + away)[:, None, None, None]

    good, fair = (m2 * CHECKPOINTS for m2 in (gauss_newton.GOOD_M2, gauss_newton.FAIR_M2))
    assert good < -returns(close(DEFAULTS[None]))[0] < -returns(close(near[None]))[0] < fair
    sizes = [len(batch(search, close)) for _ in range(2)]
    assert sizes == [1, HOPS]
    search = begin()
    batch(search, close)
    hops = batch(search, close)
    share = (np.abs(hops - DEFAULTS) > 1e-9).mean()
    assert 0.04 < share < 0.16


def distance(vectors: np.ndarray) -> np.ndarray:
    """Misses that grow with the distance (n,) from the untuned start, where the best is good."""
    away = np.abs((vectors - DEFAULTS) / WIDTH).sum(axis=1)
    return np.ones((len(vectors), 1, CHECKPOINTS, 3)) * (0.01 * (1.0 + away))[:, None, None, None]


def test_hops_from_a_good_point_are_wide_and_race_against_the_best_of_them() -> None:
    search = begin()
    batch(search, distance)
    found: list[float] = []
    shares = []
    for number in range(gauss_newton.HOP_RACES + 1):
        hops = search.ask(1000)
        assert len(hops) == HOPS
        assert search.to_beat.tolist() == [max(found) if number else -math.inf] * HOPS
        misses = distance(hops)
        search.tell(returns(misses), misses)
        found += returns(misses).tolist()
        shares.append((np.abs(hops - DEFAULTS) > 1e-9).mean())
    assert np.mean(shares) == pytest.approx(gauss_newton.WIDE_HOP_SHARE * (1.0 - INERT.mean()), rel=0.05)
    probes = search.ask(1000)
    assert len(probes) == np.count_nonzero(~INERT)
    assert np.isneginf(search.to_beat).all()
    start = np.median(probes, axis=0)  # each probe moves one parameter of it
    assert returns(distance(start[None]))[0] == max(found)


def test_hops_in_several_episodes_do_not_race() -> None:
    search = begin()
    for _ in range(3):
        misses = np.repeat(distance(search.ask(1000)), 2, axis=1)
        assert np.isneginf(search.to_beat).all()
        search.tell(returns(misses) / 2, misses)


def test_samples_and_hops_take_turns_while_the_best_is_fair() -> None:
    def fair(vectors: np.ndarray) -> np.ndarray:
        """Nothing is better than the untuned start, which is neither close nor far."""
        away = np.abs((vectors - DEFAULTS) / WIDTH).sum(axis=1) > 1e-9
        return np.full((len(vectors), 1, CHECKPOINTS, 3), 0.1) * (1 + away)[:, None, None, None]

    search = begin()
    loss = -returns(fair(DEFAULTS[None]))[0] / CHECKPOINTS
    assert descents.CLOSE_M2 < loss < gauss_newton.FAIR_M2
    starts = [size for size in (len(batch(search, fair)) for _ in range(420)) if size in (SAMPLES, HOPS)]
    assert starts[:5] == [HOPS, SAMPLES, HOPS, SAMPLES, HOPS]


def hollow(depths: dict[int, float]) -> Toy:
    """Losses by how far a point is from the start, in hundredths of a range; the largest for all others."""

    def toy(vectors: np.ndarray) -> np.ndarray:
        place = np.floor(100 * np.abs((vectors - DEFAULTS) / WIDTH).sum(axis=1)).astype(int)
        depth = np.array([depths.get(int(at), max(depths.values())) for at in place])
        return np.ones((len(vectors), 1, CHECKPOINTS, 3)) * np.sqrt(depth / 3)[:, None, None, None]

    return toy


def test_fruitless_hops_make_room_for_new_samples_until_the_best_is_good() -> None:
    def starts(loss: float, count: int = 2 * PATIENCE + 3) -> list[int]:
        """Sizes of the first starts if nothing is better than the untuned start, which loses so much."""
        search, toy = begin(), hollow({0: loss / CHECKPOINTS, 1: 1.05 * loss / CHECKPOINTS})
        sizes = (len(batch(search, toy)) for _ in range(2000))
        return [size for size in sizes if size in (SAMPLES, HOPS)][:count]

    near, good = descents.CLOSE_M2 * CHECKPOINTS, gauss_newton.GOOD_M2 * CHECKPOINTS
    turn = [HOPS] * PATIENCE + [SAMPLES]
    assert starts(0.9 * near)[: 2 * len(turn)] == turn * 2
    races = gauss_newton.HOP_RACES + 1
    assert starts(0.9 * good, (2 * PATIENCE + 3) * races) == [HOPS] * (2 * PATIENCE + 3) * races


def stop_early(misses: np.ndarray, to_beat: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return values and misses (n, 1, C, 3) of episodes that end where they are lost."""
    running = -np.cumsum((misses[:, 0] ** 2).sum(axis=2), axis=1)
    values, misses = returns(misses), misses.copy()
    for row in np.flatnonzero((running < to_beat[:, None]).any(axis=1)):
        at = int(np.argmax(running[row] < to_beat[row]))
        values[row], misses[row, 0, at + 1 :] = running[row, at], 0.0
    return values, misses


def test_stopping_what_is_lost_changes_nothing() -> None:
    whole, raced = begin(2), begin(2)
    stops = {"steps": 0, "hops": 0}
    while whole.evaluations < 9000:
        phase = whole.state()["phase"]
        misses = valley(whole.ask(1000))
        assert np.array_equal(valley(raced.ask(1000)), misses)
        values, short = stop_early(misses, raced.to_beat)
        if (short != misses).any():
            stops[phase] += 1
            assert phase == "hops" or np.isneginf(raced.to_beat[-1])  # a probe is wanted whole
        whole.tell(returns(misses), misses)
        raced.tell(values, short)
    assert min(stops.values()) > 20
    assert raced.state() == whole.state()


def test_a_climb_that_would_not_overtake_the_best_in_time_ends() -> None:
    at = Outcome(np.zeros(2), -0.5, np.zeros((1, 1, 3)))
    descent = Descent(at, False, True, np.zeros((2, 3)), 0.1, [])
    window = descents.OVERTAKING_WINDOW
    for gain, goes_on in ((0.026, True), (0.024, False)):
        descent.scores = [-0.5 - gain] + [-0.5] * window
        assert descent.overtakes(-0.4)  # too few scores to judge
        descent.scores = [-0.6, *descent.scores]
        assert descent.overtakes(-0.4) == goes_on
        assert descent.overtakes(-0.5)
    descent.survives = True
    assert descent.overtakes(-0.4)


def test_a_return_alone_is_not_enough() -> None:
    search = begin()
    with pytest.raises(ValueError, match="0 candidates wait"):
        search.tell([1.0], np.zeros((1, 1, CHECKPOINTS, 3)))
    vectors = search.ask(5)
    for call, message in (
        (lambda: search.tell([1.0]), "needs the misses"),
        (lambda: search.tell([1.0, 2.0], np.zeros((2, 1, CHECKPOINTS, 3))), "1 candidates wait"),
        (lambda: search.tell([math.nan], sphere(vectors)), "not a number"),
    ):
        with pytest.raises(ValueError, match=message):
            call()
    with pytest.raises(RuntimeError, match="before tell"):
        search.ask()
    with pytest.raises(RuntimeError, match="between ask"):
        search.state()
    with pytest.raises(ValueError, match="at least one"):
        begin().ask(0)


@pytest.mark.parametrize("done", [0, 30, 100, 151])
@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("incumbent", [0.0]),
        ("incumbent", [1e9] * LAYOUT.size),
        ("best", pack(np.zeros(3))),
        ("best", {"shape": [82], "float64": "zz"}),
        ("value", math.nan),
        ("value", "best"),
        ("evaluations", "many"),
        ("phase", "lunch"),
        ("phase", "steps"),
        ("batch", pack(np.zeros((0, 82)))),
        ("values", [1.0] * 90),
        ("misses", pack(np.zeros(5))),
        ("descent", {}),
        ("generator", {"bit_generator": "MT19937"}),
    ],
)
def test_a_damaged_state_is_refused(done: int, key: str, value: object) -> None:
    search = begin()
    advance(search, done)
    good = search.state()
    if (value, good["phase"]) == ("steps", "steps"):
        value = "samples"
    with pytest.raises((ValueError, KeyError, TypeError)):
        search.restore({**good, key: value})
    assert search.state() == good


def test_a_race_of_hops_goes_on_from_its_state_and_not_from_a_damaged_one() -> None:
    search = begin()
    advance(search, 1 + 3 * HOPS + 4, distance)
    state = search.state()
    for damage in (
        {"races": gauss_newton.HOP_RACES},
        {"races": -1},
        {"value": math.nan},
        {"point": pack(np.zeros(3))},
    ):
        with pytest.raises((ValueError, KeyError, TypeError)):
            begin().restore({**state, "hops": {**state["hops"], **damage}})
    early = begin()
    advance(early, 1)
    with pytest.raises(ValueError, match="do not go with the phase samples"):
        begin().restore({**early.state(), "hops": state["hops"]})
    again = begin(7)
    again.restore(json.loads(json.dumps(state)))
    assert again.to_beat.tolist() == search.to_beat.tolist()
    for each in (search, again):
        advance(each, 800, distance)
    assert again.state() == search.state()


def test_the_constants_fit_each_other() -> None:
    assert 0 < descents.LEAST_DAMPING < FIRST_DAMPING < descents.MOST_DAMPING
    assert gauss_newton.GOOD_M2 < descents.CLOSE_M2 < gauss_newton.FAIR_M2 < descents.STALLED_M2
    assert 0 < PROBE < 0.1
