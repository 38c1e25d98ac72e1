"""Stored results of PPO and A2C, and their training environments; none of it needs torch."""

import numpy as np
import pytest

from paper.episodes import Evaluator
from paper.gradients import CELLS, Actor, WithBonus
from paper.tasks import TASKS, draw_seeds


def random_actor(observations, actions=1, seed=0):
    rng = np.random.default_rng(seed)
    return Actor(
        rng.normal(0, 0.01, observations),
        rng.uniform(0.5, 2.0, observations),
        rng.normal(0, 1, (CELLS, observations + 1)),
        rng.normal(0, 0.3, (actions, CELLS + 1)),
    )


def test_an_actor_is_its_vector():
    actor = random_actor(4)
    again = Actor.of(actor.vector(), 4, 1)
    seen = np.array([0.1, -0.2, 0.3, 20.0])
    assert again.act(seen).tolist() == actor.act(seen).tolist()
    normal = np.clip((seen - actor.center) / np.sqrt(actor.variance + 1e-8), -10, 10)
    cells = np.tanh(actor.hidden @ [*normal, 1.0])
    np.testing.assert_allclose(actor.act(seen), actor.output @ [*cells, 1.0])
    with pytest.raises(ValueError, match="reshape"):
        Actor.of(actor.vector()[1:], 4, 1)


def test_environment_starts_and_pays_as_the_searches_do():
    task = TASKS["pendulum"]
    seeds = draw_seeds(3, (1,), 2)
    world = WithBonus(task)
    for seed, start in zip(seeds, Evaluator(task, task.policy(task.circuit())).starts(seeds), strict=True):
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
