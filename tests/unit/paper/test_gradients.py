"""Stored results of PPO and A2C, and their training environments; none of it needs torch."""

import numpy as np
import pytest

from paper.episodes import PlantEvaluator
from paper.gradients import WithBonus
from paper.tasks import TASKS, draw_seeds


def test_environment_starts_and_pays_as_the_searches_do():
    task = TASKS["pendulum"]
    seeds = draw_seeds(3, (1,), 2)
    world = WithBonus(task)
    for seed, start in zip(seeds, PlantEvaluator(task, task.policy()).starts(seeds), strict=True):
        seen, _ = world.reset(seed=int(seed))
        assert seen.tolist() == start.tolist()
    rewards, places, over = [], [], False
    while not over:
        seen, reward, over, _, info = world.step(np.array([3.0]))
        assert reward - info["bonus"] == pytest.approx(0.0 if over else 1.0)
        rewards.append(reward)
        places.append(seen[0])
    assert rewards[-1] == 0.0
    np.testing.assert_allclose(rewards[:-1], 1.0 + 0.2 * (1.0 - np.abs(places[:-1])))
