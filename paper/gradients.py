"""PPO and A2C of stable-baselines3 on the paper's tasks, with a network of eleven cells.

A run keeps the actor: one hidden layer of tanh cells, and the normalisation of observations. A few lines of
numpy score it without torch. On mountain car exploration depends on the state (Raffin et al. 2021, gSDE) and
lasts for some steps: without that, training never gets a reward.
"""

from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from paper.search import Found
from paper.tasks import Benchmark, Vector, draw_seeds

CELLS = 11
_TRAINING = 2
"""Stream of random numbers, beside those of ``search.py`` and ``runs.py``."""
# stable_baselines3.common.vec_env.VecNormalize
_VARIANCE_EPSILON, _CLIP = 1e-8, 10.0


class WithBonus(gymnasium.Wrapper[Any, Any, Any, Any]):
    """A task's Gymnasium environment; rewards include the task's bonus, which ``info`` has alone."""

    def __init__(self, task: Benchmark) -> None:
        super().__init__(gymnasium.make(task.environment, disable_env_checker=True))
        self._bonus = task.bonus
        shape: Any = self.env.action_space.shape
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, shape)  # Roboschool's pendulum ends there too

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Step."""
        seen, reward, terminated, truncated, _ = self.env.step(action)
        bonus = 0.0 if terminated else self._bonus * (1.0 - abs(float(seen[0])))
        return seen, float(reward) + bonus, terminated, truncated, {"bonus": bonus}


def train_actor(task: Benchmark, agent: str, seed: int) -> tuple[Found, dict[str, Any]]:
    """Train by ``ppo`` or ``a2c``; return what it found, and the settings.

    An actor's vector: means and variances of observations, then the weights of all cells and of all outputs,
    each with its bias last.
    """
    import torch
    from stable_baselines3 import A2C, PPO
    from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize

    torch.set_num_threads(1)
    steps, environments, options = task.gradients[agent]
    worlds = DummyVecEnv([lambda: WithBonus(task)] * environments)
    world = VecNormalize(worlds, gamma=options.get("gamma", 0.99))
    algorithm = {"ppo": PPO, "a2c": A2C}[agent]
    # Environment i gets the seed plus i, so that seeds of 0, 1, 2 would share most environments.
    spread = int(draw_seeds(seed, (_TRAINING,), 1)[0] % 2**31)
    network = {"net_arch": [CELLS], "activation_fn": torch.nn.Tanh}
    if "use_sde" in options:
        network |= {"log_std_init": 0.0, "ortho_init": False}
    model = algorithm("MlpPolicy", world, seed=spread, device="cpu", policy_kwargs=network, **options)
    model.learn(steps)
    seen: Any = world.obs_rms
    layers = (model.policy.mlp_extractor.policy_net[0], model.policy.action_net)
    hidden, output = (
        np.column_stack([layer.weight.detach().numpy(), layer.bias.detach().numpy()]).astype(np.float64)
        for layer in layers
    )
    settings = {"cells": CELLS, "environments": environments, **options}
    vector = np.concatenate([np.ravel(part) for part in (seen.mean, seen.var, hidden, output)])
    return Found(vector, int(model.num_timesteps)), settings


def score_actor(task: Benchmark, vector: Vector, seeds: NDArray[np.uint64]) -> tuple[Vector, Vector]:
    """Return an actor's returns with bonus, and Gymnasium's, (n,) each, in episodes of seeds (n,)."""
    world = WithBonus(task)
    acted: Any = world.action_space
    inputs = int(np.prod(world.observation_space.shape or ()))
    center, variance, hidden, output = np.split(vector, np.cumsum([inputs, inputs, CELLS * (inputs + 1)]))
    hidden, output = hidden.reshape(CELLS, -1), output.reshape(-1, CELLS + 1)
    returns = np.zeros((len(seeds), 2))
    for number, seed in enumerate(seeds):
        seen, _ = world.reset(seed=int(seed))
        over = False
        while not over:
            deviation = np.asarray(seen, np.float64) - center
            normal = np.clip(deviation / np.sqrt(variance + _VARIANCE_EPSILON), -_CLIP, _CLIP)
            cells = np.tanh(hidden[:, :-1] @ normal + hidden[:, -1])
            action = np.clip(output[:, :-1] @ cells + output[:, -1], acted.low, acted.high)
            seen, reward, terminated, truncated, info = world.step(action.astype(np.float64))
            over = terminated or truncated
            returns[number] += reward, reward - info["bonus"]
    return returns[:, 0], returns[:, 1]
