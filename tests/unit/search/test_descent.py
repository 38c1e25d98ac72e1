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
