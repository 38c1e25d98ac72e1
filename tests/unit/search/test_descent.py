"""One descent of the Gauss-Newton search and its least squares."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim.learn.search.least_squares import LeastSquares, scored


def outcome(point, residuals):
    [found] = scored(point[None], [-float((residuals**2).sum())], residuals[None])
    return found


def problem(slopes, factors=(1.0,)):
    """Least squares with slopes (D, R)."""
    made = LeastSquares(len(slopes), slopes.shape[1] // 3, factors)
    made.slopes[:] = slopes
    return made


# -- arithmetic --------------------------------------------------------------------------------------------


@given(
    parameters=st.integers(1, 30),
    checkpoints=st.integers(1, 10),
    damping=st.floats(1e-2, 1e3),
    lifetime=st.sampled_from([0.0, 5.0]),
    seed=st.integers(0, 10**6),
)
def test_steps_solve_the_damped_normal_equations(parameters, checkpoints, damping, lifetime, seed):
    rng = np.random.default_rng(seed)
    slopes = rng.standard_normal((parameters, 3 * checkpoints))
    residuals = rng.standard_normal(3 * checkpoints)
    point = np.where(rng.random(parameters) < 0.3, np.round(rng.random(parameters)), rng.random(parameters))
    least_squares, at = problem(slopes, (1.0, 10.0)), outcome(point, residuals.reshape(-1, 3))
    *targets, start = least_squares.steps(at, damping, 2, lifetime)
    assert start.tolist() == point.tolist()
    assert least_squares.steps(at, damping, 1, lifetime).tolist() == [targets[0].tolist(), start.tolist()]
    weights = least_squares.weights
    assert lifetime > 0.0 or (weights == 1.0).all()
    slopes, residuals = slopes * weights, residuals * weights
    gradient = slopes @ residuals
    held = ((point == 0) & (gradient > 0)) | ((point == 1) & (gradient < 0))
    free = np.where(held[:, None], 0.0, slopes)
    for target, lam in zip(targets, (damping, 10 * damping), strict=True):
        step = np.linalg.solve(free @ free.T + lam * np.eye(parameters), -free @ residuals)
        assert target == pytest.approx(np.clip(point + step, 0, 1), abs=1e-8)


def test_slope_that_is_not_a_number_is_an_error():
    slopes = np.ones((5, 6))
    slopes[3, 2] = np.nan
    with pytest.raises(np.linalg.LinAlgError, match="not finite"):
        problem(slopes).steps(outcome(np.full(5, 0.5), np.ones((2, 3))), 1.0, 1)


def test_correction_explains_the_step_and_changes_nothing_across_it():
    rng = np.random.default_rng(0)
    before, residuals, found = rng.normal(size=(7, 12)), rng.normal(size=(4, 3)), rng.normal(size=(4, 3))
    point, step = rng.normal(size=7), rng.normal(size=7)
    least_squares, at = problem(before), outcome(point, residuals)
    # Of a truncated step the first residuals are known.
    lost = -float((found[:1] ** 2).sum()) - 1e-9
    least_squares.correct(at, outcome(point + step, found), lost)
    slopes = least_squares.slopes
    assert step @ slopes[:, :6] == pytest.approx((found - residuals)[:2].ravel())
    assert slopes[:, 6:].tolist() == before[:, 6:].tolist()
    across = rng.normal(size=7)
    across -= step * (across @ step) / (step @ step)
    assert across @ slopes == pytest.approx(across @ before)
    once = slopes.copy()
    least_squares.correct(at, outcome(point.copy(), found), -math.inf)
    assert slopes.tolist() == once.tolist()


def test_probe_measures_the_slopes_of_the_parameter_that_it_moved():
    rng = np.random.default_rng(1)
    before, residuals, found = rng.normal(size=(5, 6)), rng.normal(size=(2, 3)), rng.normal(size=(2, 3))
    point = rng.normal(size=5)
    there = point.copy()
    there[3] -= 0.25
    least_squares = problem(before)
    least_squares.measure(outcome(point, residuals), outcome(there, found))
    slopes = least_squares.slopes
    assert slopes[3] == pytest.approx(-4.0 * (found - residuals).ravel())
    assert np.delete(slopes, 3, axis=0).tolist() == np.delete(before, 3, axis=0).tolist()


def test_survival_counts_checkpoints_and_its_weights_are_its_slopes():
    rng = np.random.default_rng(2)
    residuals, lifetime, point = rng.normal(size=(6, 3)), 5.0, np.zeros(1)
    least_squares = problem(np.ones((1, 18)))

    def survival(residuals):
        return least_squares.survival(outcome(point, residuals), lifetime)

    assert survival(np.zeros((6, 3))) == 6.0
    assert survival(np.full((6, 3), 1e6)) == pytest.approx(0.0, abs=1e-200)
    loss = np.cumsum((residuals**2).sum(axis=1))
    assert survival(residuals) == pytest.approx(np.exp(-loss / lifetime).sum())
    least_squares.steps(outcome(point, residuals), 1.0, 1, lifetime)
    weights = least_squares.weights.reshape(residuals.shape)
    assert np.mean(weights**2) == pytest.approx(1.0)
    # The gradient of survival is that of the weighted squares, but for sign and scale.
    step, slopes = 1e-6, np.empty_like(residuals)
    for at in np.ndindex(*residuals.shape):
        moved = residuals.copy()
        moved[at] += step
        slopes[at] = (survival(moved) - survival(residuals)) / step
    ratio = slopes / (weights**2 * residuals)
    assert ratio == pytest.approx(np.full_like(ratio, ratio.flat[0]), rel=1e-3)
    assert ratio.flat[0] < 0


@pytest.mark.parametrize(
    ("to_beat", "known"), [(-0.05, 1), (-0.1001, 2), (-0.7, 3), (-0.9, 3), (-math.inf, 3)]
)
def test_misses_are_known_up_to_the_checkpoint_where_the_return_is_lost(to_beat, known):
    residuals = np.sqrt(np.array([[0.1, 0.0, 0.0], [0.1, 0.1, 0.0], [0.0, 0.0, 0.5]]))
    least_squares = problem(np.ones((1, 9)))
    at, there = outcome(np.zeros(1), np.zeros((3, 3))), outcome(np.ones(1), residuals)
    least_squares.correct(at, there, to_beat)
    assert (least_squares.slopes == 1.0).all(axis=0).tolist() == [False] * 3 * known + [True] * 3 * (
        3 - known
    )


def test_outcomes_and_least_squares_have_one_shape():
    least_squares, at = problem(np.ones((5, 6))), outcome(np.full(5, 0.5), np.ones((2, 3)))
    for other in (outcome(np.full(4, 0.5), np.ones((2, 3))), outcome(np.full(5, 0.5), np.ones((1, 3)))):
        for call in (
            lambda other=other: least_squares.steps(other, 1.0, 1),
            lambda other=other: least_squares.measure(at, other),
            lambda other=other: least_squares.correct(other, at, 0.0),
            lambda other=other: least_squares.survival(other, 1.0),
        ):
            with pytest.raises(ValueError, match="an outcome of"):
                call()
    for count in (0, 2):
        with pytest.raises(ValueError, match="expected 1 to 1"):
            least_squares.steps(at, 1.0, count)
    points, residuals = np.ones((2, 5)), np.ones((2, 2, 3))
    for wrong in (points.T.copy().T, points[:, ::2], points[:1], points.astype(np.float32)):
        with pytest.raises((TypeError, ValueError)):
            scored(wrong, [0.0, 0.0], residuals)
    for wrong in (residuals[:1], np.ones((2, 2, 2)), residuals[:, ::-1]):
        with pytest.raises((TypeError, ValueError)):
            scored(points, [0.0, 0.0], wrong)
