"""Parts of the Gauss-Newton search: its box, its arithmetic, its file."""

import json
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rover_ncp.circuit.circuit import ParameterKind
from rover_ncp.circuit.compiled import inert_parameters
from rover_ncp.circuit.policy import ParameterLayout, parking_policy
from rover_ncp.circuit.tap_withdrawal import parking_circuit
from sim.learn.search.least_squares import (
    correct_slopes,
    damped_steps,
    lost_at,
    measure_slope,
    survival,
    survival_weights,
)
from sim.learn.search.packed import pack, unpack
from sim.learn.search.unit_box import UnitBox, reflected

POLICY = parking_policy(parking_circuit())
LAYOUT = POLICY.layout()
DEFAULTS = POLICY.parameters()
WIDTH = LAYOUT.upper - LAYOUT.lower
INERT = inert_parameters(POLICY)


# -- the unit box ------------------------------------------------------------------------------------------


def test_the_box_reaches_every_bound_and_comes_back_to_the_start() -> None:
    box = UnitBox(LAYOUT, DEFAULTS)
    corners = box.vectors(np.array([np.zeros(box.size), np.ones(box.size)]))
    assert corners[0].tolist() == LAYOUT.lower.tolist()
    assert corners[1] == pytest.approx(LAYOUT.upper, rel=1e-12)
    assert box.vectors(box.start[None])[0] == pytest.approx(DEFAULTS, rel=1e-12)
    middle = box.vectors(np.full((1, box.size), 0.5))[0]
    leak = LAYOUT.block(ParameterKind.LEAK)
    assert middle[leak.slice] == pytest.approx(math.sqrt(leak.lower * leak.upper))
    weight = LAYOUT.block(ParameterKind.WEIGHT)
    assert middle[weight.slice] == pytest.approx((weight.lower + weight.upper) / 2)


def test_layers_are_parameters_like_any_other() -> None:
    layout = ParameterLayout(LAYOUT.blocks[:1])
    box = UnitBox(layout, DEFAULTS[: layout.size], np.zeros(layout.size, bool))
    assert box.size == layout.size


def test_walls_are_mirrors() -> None:
    points = np.array([-0.25, 0.0, 0.3, 1.0, 1.2, 2.5, -1.5])
    assert reflected(points) == pytest.approx([0.25, 0.0, 0.3, 1.0, 0.8, 0.5, 0.5])


def test_inert_parameters_change_no_return_and_all_others_do() -> None:
    from rover_ncp.course.course import load_course
    from sim.learn.evaluator import Evaluator

    rng = np.random.default_rng(1)
    base = np.clip(DEFAULTS + 0.05 * WIDTH * rng.standard_normal(LAYOUT.size), LAYOUT.lower, LAYOUT.upper)
    vectors = np.tile(base, (LAYOUT.size + 1, 1))
    for i in range(LAYOUT.size):
        vectors[i, i] += 0.01 * WIDTH[i] * (1 if base[i] < LAYOUT.upper[i] - 0.02 * WIDTH[i] else -1)
    _, misses = Evaluator(POLICY, load_course("parking")).run(vectors)
    same = np.array([np.array_equal(row, misses[-1]) for row in misses[:-1]])
    assert same.tolist() == INERT.tolist()


# -- arithmetic --------------------------------------------------------------------------------------------


@given(
    parameters=st.integers(1, 30),
    residuals=st.integers(1, 30),
    damping=st.floats(1e-2, 1e3),
    seed=st.integers(0, 10**6),
)
@settings(max_examples=60, deadline=None)
def test_steps_are_those_of_a_linear_algebra_library(
    parameters: int, residuals: int, damping: float, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    slopes, misses = rng.standard_normal((parameters, residuals)), rng.standard_normal(residuals)
    point = np.where(rng.random(parameters) < 0.3, np.round(rng.random(parameters)), rng.random(parameters))
    dampings, targets = np.array([damping, 10 * damping]), np.empty((2, parameters))
    weights = np.where(rng.random(residuals) < 0.5, 1.0, rng.random(residuals))
    damped_steps(slopes, misses, weights, point, dampings, targets)
    slopes, misses = slopes * weights, misses * weights
    gradient = slopes @ misses
    held = ((point == 0) & (gradient > 0)) | ((point == 1) & (gradient < 0))
    free = np.where(held[:, None], 0.0, slopes)
    for target, lam in zip(targets, dampings, strict=True):
        step = np.linalg.solve(free @ free.T + lam * np.eye(parameters), -free @ misses)
        assert target == pytest.approx(np.clip(point + step, 0, 1), abs=1e-8)


def test_without_damping_worth_the_name_a_singular_system_still_gives_a_step() -> None:
    slopes = np.full((5, 66), 1e4)
    targets = np.empty((1, 5))
    damped_steps(slopes, np.ones(66), np.ones(66), np.full(5, 0.5), np.array([1e-9]), targets)
    assert np.isfinite(targets).all()


def test_a_correction_explains_the_step_and_touches_nothing_across_it() -> None:
    rng = np.random.default_rng(0)
    slopes, origin, step = rng.normal(size=(7, 12)), rng.random(7), rng.normal(size=7)
    there, change = rng.normal(size=(1, 4, 3)), rng.normal(size=(1, 4, 3))
    before = slopes.copy()
    # Of a step that was stopped the first two checkpoints are known.
    correct_slopes(slopes, origin, there, origin + step, there + change, 2)
    assert step @ slopes[:, :6] == pytest.approx(change.ravel()[:6])
    assert slopes[:, 6:].tolist() == before[:, 6:].tolist()
    across = rng.normal(size=7)
    across -= step * (across @ step) / (step @ step)
    assert across @ slopes == pytest.approx(across @ before)
    once = slopes.copy()
    correct_slopes(slopes, origin, there, origin, there + change, 4)  # no step teaches nothing
    assert slopes.tolist() == once.tolist()


def test_a_probe_teaches_the_slopes_of_its_parameter() -> None:
    rng = np.random.default_rng(0)
    slopes, origin, there = rng.normal(size=(7, 24)), rng.random(7), rng.normal(size=(2, 4, 3))
    point, misses, expected = origin.copy(), rng.normal(size=(2, 4, 3)), slopes.copy()
    point[4] -= 3e-3
    expected[4] = (misses - there).ravel() / (point[4] - origin[4])
    measure_slope(slopes, origin, there, point, misses)
    assert slopes.tolist() == expected.tolist()


def test_survival_counts_the_checkpoints_reached_and_its_weights_are_its_slopes() -> None:
    rng = np.random.default_rng(2)
    misses = rng.normal(size=(2, 6, 3))
    assert survival(np.zeros((2, 6, 3)), 5.0) == 6.0
    assert survival(np.full((1, 6, 3), 1e6), 5.0) == pytest.approx(0.0, abs=1e-300)
    loss = np.cumsum((misses**2).sum(axis=2), axis=1)
    assert survival(misses, 5.0) == pytest.approx(np.exp(-loss / 5.0).sum(axis=1).mean())
    weights = np.empty_like(misses)
    survival_weights(misses, 5.0, weights)
    assert np.mean(weights**2) == pytest.approx(1.0)
    # The gradient of survival is that of the weighted squares, but for sign and scale.
    step, slopes = 1e-6, np.empty_like(misses)
    for at in np.ndindex(*misses.shape):
        moved = misses.copy()
        moved[at] += step
        slopes[at] = (survival(moved, 5.0) - survival(misses, 5.0)) / step
    ratio = slopes / (weights**2 * misses)
    assert ratio == pytest.approx(np.full_like(ratio, ratio.flat[0]), rel=1e-3)
    assert ratio.flat[0] < 0


def test_a_return_is_lost_at_the_first_checkpoint_below() -> None:
    misses = np.sqrt(np.array([[[0.1, 0.0, 0.0], [0.1, 0.1, 0.0], [0.0, 0.0, 0.5]]]))
    for to_beat, known, total in (
        (-0.05, 1, -0.1),
        (-0.1001, 2, -0.3),
        (-0.7, 3, -0.8),
        (-0.9, 3, -math.inf),
    ):
        found = lost_at(misses, to_beat)
        assert found == (known, pytest.approx(total))
    assert lost_at(misses, -math.inf) == (3, -math.inf)


def test_arrays_keep_their_bits_and_a_damaged_one_is_refused() -> None:
    array = np.array([[0.1, -0.0, 5e-324], [math.inf, 1e308, math.pi]])
    packed = json.loads(json.dumps(pack(array)))
    assert unpack(packed, (2, None)).tobytes() == array.tobytes()
    for shape in ((3, 2), (6,), (None, None, None)):
        with pytest.raises(ValueError, match="expected an array of shape"):
            unpack(packed, shape)
    with pytest.raises(ValueError, match=r"buffer size|cannot reshape|hexadecimal"):
        unpack({**packed, "float64": "00"}, (2, 3))
