"""PPO of stable-baselines3 parks the rover. ``make paper-gradients`` installs stable-baselines3.

The environment judges a drive at its checkpoints alone. Training adds what a drive needs between them: where
the path through the checkpoints is, seen from the rover, and a reward for being on it. The return that is
printed is the environment's own.
"""

import sys

import gymnasium
import numpy as np
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize

AHEAD_S = (0.5, 1.0, 2.0)
"""How far ahead the path is seen: the rover obeys a command after 0.15 s, and takes time to turn."""
ENVIRONMENTS, TICKS = 8, 320
ENOUGH = -0.1


class Guided(gymnasium.Wrapper):
    """Observe the path ahead in the rover's frame (m, m, rad each), and be rewarded at each tick."""

    def __init__(self):
        env = gymnasium.make("sim.world.env:rover_ncp/RoverParking-v0")
        super().__init__(gymnasium.wrappers.RescaleAction(env, np.float32(-1), np.float32(1)))
        self.observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (3 * len(AHEAD_S) + 1,))
        points = env.unwrapped.course.checkpoints
        self.times = [point.t for point in points]
        self.path = np.array([point.pose for point in points]).T

    def reset(self, **options):
        """Begin at the course's start."""
        pose, info = self.env.reset(**options)
        return self.seen(pose, info["time_s"]), info

    def step(self, action):
        """Advance; ``info`` has the environment's own reward as ``judged``."""
        pose, reward, terminated, truncated, info = self.env.step(action)
        miss = pose[:3] - self.at(info["time_s"])
        info["judged"] = reward
        return self.seen(pose, info["time_s"]), -float(miss @ miss), terminated, truncated, info

    def at(self, t):
        """Return where the path is at a time (s): x, y, theta."""
        return np.array([np.interp(t, self.times, row) for row in self.path])

    def seen(self, pose, t):
        """Return the observation at a pose and a time."""
        x, y, theta, start = pose
        parts = [start]
        for ahead in AHEAD_S:
            dx, dy, turn = self.at(t + ahead) - (x, y, theta)
            parts += [
                np.cos(theta) * dx + np.sin(theta) * dy,
                np.cos(theta) * dy - np.sin(theta) * dx,
                turn,
            ]
        return np.array(parts, np.float32)


def make(seed=0):
    """Return an untrained model; its environment normalises observations and rewards."""
    torch.set_num_threads(1)
    world = VecNormalize(DummyVecEnv([Guided] * ENVIRONMENTS), gamma=0.97, clip_obs=5.0)
    return PPO(
        "MlpPolicy",
        world,
        n_steps=TICKS,
        batch_size=320,
        learning_rate=5e-4,
        gamma=0.97,
        policy_kwargs={"log_std_init": -1.0},
        seed=seed,
        device="cpu",
    )


def judged_return(model):
    """Drive once without exploration; return the environment's return."""
    env, world, total, over = Guided(), model.get_env(), 0.0, False
    seen, _ = env.reset()
    while not over:
        action, _ = model.predict(world.normalize_obs(seen), deterministic=True)
        seen, _, over, _, info = env.step(action)
        total += info["judged"]
    return total


def train(model, steps):
    """Train for so many steps more, or until a drive is good enough; return the last drive's return."""
    until, found = model.num_timesteps + steps, judged_return(model)
    while found < ENOUGH and model.num_timesteps < until:
        model.learn(10 * ENVIRONMENTS * TICKS, reset_num_timesteps=False)
        found = judged_return(model)
        print(f"{model.num_timesteps} steps: return {found:.4f}", flush=True)
    return found


if __name__ == "__main__":
    sys.exit(0 if train(make(), 2_000_000) >= ENOUGH else 1)
