"""PPO and A2C of stable-baselines3 on the paper's tasks, with a network of eleven cells.

A run keeps the actor: one hidden layer of tanh cells, and the normalisation of observations. A few lines of
numpy score it without torch. On mountain car exploration depends on the state (Raffin et al. 2021, gSDE) and
lasts for some steps: without that, training never gets a reward.
"""

from typing import Any, NamedTuple

import gymnasium
import numpy as np
from numpy.typing import NDArray

from sim.learn.search.base import Vector
from sim.paper.evaluator import make_plants
from sim.paper.plants.lanes import reset_plant, step_plant
from sim.paper.tasks import Benchmark

FloatArray = NDArray[np.float64]
Training = tuple[int, int, dict[str, Any]]
"""Steps in all, environments side by side, and options that differ from the library's defaults."""

CELLS = 11
_QUICK_STEPS = 4096
# stable_baselines3.common.vec_env.VecNormalize
_VARIANCE_EPSILON, _CLIP = 1e-8, 10.0


_BY_STATE = {"use_sde": True, "sde_sample_freq": 16}
_PENDULUM: dict[str, Training] = {
    "ppo": (60_000, 8, {"n_steps": 128, "batch_size": 128, "learning_rate": 1e-3}),
    "a2c": (100_000, 8, {"n_steps": 16, "gae_lambda": 0.95, "learning_rate": 3e-3}),
}
_CAR_PPO = {"n_steps": 128, "batch_size": 256, "gamma": 0.999, "learning_rate": 1e-3}
_CAR: dict[str, Training] = {"ppo": (60_000, 8, _CAR_PPO | _BY_STATE), "a2c": (60_000, 4, _BY_STATE)}


class PaperEnvironment(gymnasium.Env[Any, Any]):
    """A task's plant as a Gymnasium environment, which shows its whole state; rewards include the bonus."""

    def __init__(self, task: Benchmark) -> None:
        with gymnasium.make(task.environment) as made:
            self.observation_space, self.action_space = made.observation_space, made.action_space
        self._task, self._steps = task, 0
        self._plants, self._pool = make_plants(task, 1)

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[Any, dict[str, Any]]:
        """Begin an episode; a seed gives the start of ``Evaluator.starts``."""
        super().reset(seed=seed)
        self._steps = 0
        reset_plant(self._plants, 0, self._task.start(self.np_random))
        return self._seen(), {}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Step; ``info`` has the bonus alone."""
        self._steps += 1
        commands = np.asarray(action, np.float64)[:, None]
        reward, bonus, terminated = step_plant(self._plants, 0, commands)
        over = self._steps == self._task.horizon
        return self._seen(), reward + bonus, terminated, over, {"bonus": bonus}

    def _seen(self) -> Any:
        return self._plants.state[:, 0].astype(self.observation_space.dtype)


class Actor(NamedTuple):
    """Result of a training: means and variances of observations, weights of cells and of the output."""

    center: FloatArray
    variance: FloatArray
    hidden: FloatArray
    """(CELLS, observations + 1), the last column the biases."""
    output: FloatArray
    """(actions, CELLS + 1)."""

    def vector(self) -> Vector:
        """Return all numbers as one vector."""
        return np.concatenate([part.ravel() for part in self])

    @classmethod
    def of(cls, vector: Vector, observations: int, actions: int) -> "Actor":
        """Return the actor of a vector. Raises ValueError for one of another length."""
        shapes = ((observations,), (observations,), (CELLS, observations + 1), (actions, CELLS + 1))
        parts = np.split(vector, np.cumsum([int(np.prod(shape)) for shape in shapes[:-1]]))
        return cls(*(part.reshape(shape) for part, shape in zip(parts, shapes, strict=True)))

    def act(self, seen: FloatArray) -> FloatArray:
        """Return the action for an observation."""
        normal = np.clip((seen - self.center) / np.sqrt(self.variance + _VARIANCE_EPSILON), -_CLIP, _CLIP)
        cells = np.tanh(self.hidden[:, :-1] @ normal + self.hidden[:, -1])
        action: FloatArray = self.output[:, :-1] @ cells + self.output[:, -1]
        return action


def train_actor(task: Benchmark, agent: str, seed: int, *, quick: bool) -> tuple[Actor, int, dict[str, Any]]:
    """Train by ``ppo`` or ``a2c``; return the actor, the steps taken and the settings."""
    import torch
    from stable_baselines3 import A2C, PPO
    from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize

    torch.set_num_threads(1)
    steps, environments, options = (_CAR if task.plant == "mountain-car" else _PENDULUM)[agent]
    worlds = DummyVecEnv([lambda: PaperEnvironment(task)] * environments)
    world = VecNormalize(worlds, gamma=options.get("gamma", 0.99))
    algorithm = {"ppo": PPO, "a2c": A2C}[agent]
    network = {"net_arch": [CELLS], "activation_fn": torch.nn.Tanh}
    if "use_sde" in options:
        network |= {"log_std_init": 0.0, "ortho_init": False}
    model = algorithm("MlpPolicy", world, seed=seed, device="cpu", policy_kwargs=network, **options)
    model.learn(_QUICK_STEPS if quick else steps)
    seen: Any = world.obs_rms
    layers = (model.policy.mlp_extractor.policy_net[0], model.policy.action_net)
    hidden, output = (
        np.column_stack([layer.weight.detach().numpy(), layer.bias.detach().numpy()]).astype(np.float64)
        for layer in layers
    )
    settings = {"cells": CELLS, "environments": environments, **options}
    return Actor(np.array(seen.mean), np.array(seen.var), hidden, output), int(model.num_timesteps), settings


def score_actor(task: Benchmark, vector: Vector, seeds: NDArray[np.uint64]) -> tuple[FloatArray, FloatArray]:
    """Return an actor's returns with bonus, and Gymnasium's, (n,) each, in episodes of seeds (n,)."""
    world = PaperEnvironment(task)
    [observations], [actions] = world.observation_space.shape, world.action_space.shape  # type: ignore[misc]
    low, high = world.action_space.low, world.action_space.high  # type: ignore[attr-defined]
    actor = Actor.of(vector, observations, actions)
    returns = np.zeros((len(seeds), 2))
    for number, seed in enumerate(seeds):
        seen, _ = world.reset(seed=int(seed))
        over = False
        while not over:
            action = np.clip(actor.act(np.asarray(seen, np.float64)), low, high).astype(np.float64)
            seen, reward, terminated, truncated, info = world.step(action)
            over = terminated or truncated
            returns[number] += reward, reward - info["bonus"]
    return returns[:, 0], returns[:, 1]
