"""Estimates of a return: which rollouts are averaged, and which random numbers they see."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim.learn.objective import Deterministic, Sampled, mean_of_worst

RETURNS = [3.0, -1.0, 2.0, -5.0]


@pytest.mark.parametrize(("worst", "mean"), [(1, -5.0), (2, -3.0), (3, -4.0 / 3.0), (4, -0.25)])
def test_mean_of_the_worst(worst: int, mean: float) -> None:
    assert mean_of_worst(RETURNS, worst) == pytest.approx(mean, rel=1e-15)


@given(st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=20), st.data())
def test_the_mean_has_the_same_bits_in_every_order(returns: list[float], data: st.DataObject) -> None:
    worst = data.draw(st.integers(1, len(returns)))
    shuffled = data.draw(st.permutations(returns))
    mean = mean_of_worst(returns, worst)
    assert mean_of_worst(shuffled, worst) == mean
    assert min(returns) - 1e-9 <= mean <= sum(returns) / len(returns) + 1e-9


def noisy(vectors: np.ndarray, seeds: np.ndarray) -> np.ndarray:
    """A return that is its vector's sum plus noise that its seed alone decides."""
    noise = [np.random.default_rng(seed).normal() for seed in seeds]
    return vectors.sum(axis=1) + np.array(noise)


def test_an_estimate_depends_on_its_key_and_not_on_its_company() -> None:
    objective = Sampled(noisy, root_seed=4, rollouts=5, worst=2)
    vectors = np.arange(12.0).reshape(4, 3)
    keys = [(0, 1, 0), (0, 1, 1), (7, 1, 0), (7, 1, 250)]
    nothing = np.full(4, -np.inf)
    together = objective.estimate(vectors, nothing, keys)
    alone = [objective.estimate(v[None], nothing[:1], [key])[0] for v, key in zip(vectors, keys, strict=True)]
    assert together.tolist() == alone
    same_vector = objective.estimate(np.zeros((4, 3)), nothing, keys)
    assert len(set(same_vector.tolist())) == 4  # no two streams are alike
    other_root = Sampled(noisy, root_seed=5, rollouts=5, worst=2).estimate(vectors, nothing, keys)
    assert not np.isin(other_root, together).any()


def test_n_rollouts_are_run_and_the_worst_are_averaged() -> None:
    seen: list[np.ndarray] = []

    def returns(vectors: np.ndarray, seeds: np.ndarray) -> np.ndarray:
        seen.append(seeds)
        assert len(vectors) == len(seeds) == 20
        return np.tile([4.0, 1.0, 3.0, 2.0, 10.0], 4) * vectors[:, 0]

    objective = Sampled(returns, root_seed=0, rollouts=5, worst=3)
    vectors = np.array([[1.0], [10.0], [100.0], [1000.0]])
    estimates = objective.estimate(vectors, np.zeros(4), [(i, 1, 0) for i in range(4)])
    assert estimates.tolist() == [2.0, 20.0, 200.0, 2000.0]
    assert len(np.unique(seen[0])) == 20


def test_a_deterministic_task_runs_once_and_may_race() -> None:
    def returns(vectors: np.ndarray, to_beat: np.ndarray) -> np.ndarray:
        return np.where(vectors[:, 0] > to_beat, vectors[:, 0], -99.0)

    estimates = Deterministic(returns).estimate(np.array([[1.0], [2.0]]), np.array([0.0, 5.0]), [(0,), (1,)])
    assert estimates.tolist() == [1.0, -99.0]


@pytest.mark.parametrize(("rollouts", "worst"), [(5, 0), (5, 6), (0, 0)])
def test_impossible_numbers_are_refused(rollouts: int, worst: int) -> None:
    with pytest.raises(ValueError, match="cannot be taken"):
        Sampled(noisy, 0, rollouts, worst)
