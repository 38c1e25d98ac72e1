"""The Gauss-Newton search on toy objectives: what it measures and decides, and that it repeats to the bit."""

import numpy as np
import pytest
from kit.toy_search import CHECKPOINTS, DEFAULTS, INERT, LAYOUT, WIDTH, ToySearch, returns

from rover_ncp.circuit.circuit import ParameterKind
from sim.learn.search.descent import CONSTANTS
from sim.learn.search.unit_box import UnitBox

FREE = np.flatnonzero(~INERT)
SAMPLES, RESTARTS = CONSTANTS.samples, CONSTANTS.restarts


def valley(vectors):
    """Residuals of a bent, narrow valley (Rosenbrock's) between each two parameters, with other hollows."""
    unit = 3.0 * (vectors - LAYOUT.lower) / WIDTH - 1.0
    unit[:, INERT] = 1.0
    residuals = np.zeros((len(vectors), CHECKPOINTS, 3))
    a, b = unit[:, 0 : 2 * CHECKPOINTS : 2], unit[:, 1 : 2 * CHECKPOINTS : 2]
    residuals[:, : a.shape[1], 0] = 1.0 - a
    residuals[:, : b.shape[1], 1] = 3.0 * (b - a[:, : b.shape[1]] ** 2)
    residuals[:, : a.shape[1], 2] = 0.2 * np.sin(5.0 * (a - 1.0))
    return residuals


def begin(seed=0):
    return ToySearch("gauss-newton", seed)


# -- the search --------------------------------------------------------------------------------------------


def test_one_descent_reaches_the_goal_of_linear_misses():
    box = UnitBox.of(LAYOUT, DEFAULTS, INERT)
    target = np.random.default_rng(3).uniform(0.2, 0.8, box.size)

    def linear(vectors):
        unit = (vectors - LAYOUT.lower) / WIDTH
        for kind in (ParameterKind.LEAK, ParameterKind.CAPACITANCE):
            at = LAYOUT.block(kind).slice
            lower, upper = LAYOUT.lower[at], LAYOUT.upper[at]
            unit[:, at] = np.log(vectors[:, at] / lower) / np.log(upper / lower)
        residuals = np.zeros((len(vectors), CHECKPOINTS * 3))
        residuals[:, : box.size] = unit[:, box.free] - target
        return residuals.reshape(len(vectors), CHECKPOINTS, 3)

    search = begin()
    search.advance(1 + SAMPLES + box.size + 60, linear)
    assert search.best == pytest.approx(box.vectors(target[None])[0], rel=1e-4, abs=1e-4)


def test_candidates_move_every_parameter_but_the_inert_ones():
    search = begin(3)
    seen = np.concatenate([search.step(valley) for _ in range(200)])
    assert np.all(seen[:, INERT] == DEFAULTS[INERT])
    assert np.all(np.ptp(seen[:, ~INERT], axis=0) > 0)


def test_dead_motor_neuron_is_revived():
    def motor(vectors):
        """Residuals that eight parameters could end, each from 3.5 deviations of the samples on."""
        away = (vectors - DEFAULTS) / WIDTH
        acts = np.maximum(away[:, FREE[:8]] - 0.35, 0.0).sum(axis=1)
        residuals = np.zeros((len(vectors), CHECKPOINTS, 3))
        residuals[:, :4, 0] = (1.0 - 3.0 * acts)[:, None]
        residuals[:, :, 1] = away[:, FREE[20:21]] - 0.01
        return residuals

    search = begin()
    sizes = []
    while search.value < -1.0:
        sizes.append(len(search.step(motor)))
        assert search.tried < 3000
    assert max(sizes.count(SAMPLES), sizes.count(RESTARTS)) == 1


def truncated(residuals, to_beat):
    """Return values and residuals (n, C, 3) of episodes that end where they are lost."""
    running = -np.cumsum((residuals**2).sum(axis=2), axis=1)
    values, residuals = returns(residuals), residuals.copy()
    for row in np.flatnonzero((running < to_beat[:, None]).any(axis=1)):
        at = int(np.argmax(running[row] < to_beat[row]))
        values[row], residuals[row, at + 1 :] = running[row, at], 0.0
    return values, residuals


def test_truncating_lost_episodes_changes_no_candidate():
    whole, raced, lost = begin(2), begin(2), 0
    while whole.tried < 9000:
        residuals = valley(whole.batch.vectors)
        assert np.array_equal(valley(raced.batch.vectors), residuals)
        values, short = truncated(residuals, raced.batch.to_beat)
        lost += bool((short != residuals).any())
        whole.tell(returns(residuals), residuals)
        raced.tell(values, short)
    assert lost > 40


def test_path_of_a_seed_stays():
    """A decision that changes leads elsewhere within these candidates."""
    search = begin(12)
    search.advance(300, valley)
    assert search.value == pytest.approx(-0.20042689078744516, rel=1e-3)
