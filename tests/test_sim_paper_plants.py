"""Plants in lanes against Gymnasium's environments, step by step."""

import gymnasium
import numpy as np
import pytest

from sim.paper.mujoco_plants import MujocoPool
from sim.paper.plants import allocate_plants, observe, reset_plant, step_plant
from sim.paper.tasks import TASKS


class Plant:
    """One plant, stepped from Python as a kernel does."""

    def __init__(self, name, lanes=3, lane=1):
        task = TASKS[name]
        self.pool = None
        if task.mujoco:
            self.pool = MujocoPool(task.mujoco.file, task.mujoco.frames, lanes, task.mujoco.step_s)
            self.plants = allocate_plants(task.plant, lanes, task.bonus, self.pool.lanes)
        else:
            self.plants = allocate_plants(task.plant, lanes, task.bonus)
        self.lane, self.lanes = lane, lanes

    def reset(self, start):
        reset_plant(self.plants, self.lane, np.array(start, float))

    def observe(self, size):
        seen = np.full((size, self.lanes), np.nan)
        observe(self.plants, self.lane, seen)
        return seen[:, self.lane]

    def step(self, commands):
        column = np.zeros((len(commands), self.lanes))
        column[:, self.lane] = commands
        return step_plant(self.plants, self.lane, column)


def starts(name, seeds):
    task = TASKS[name]
    return np.array([task.start(np.random.Generator(np.random.PCG64(seed))) for seed in seeds])


def push(seed):
    """Return actions that hold for some steps, so that plants get far: -1, 1 or anything between."""
    rng = np.random.default_rng(seed)
    held = np.repeat(np.clip(rng.normal(0.0, 1.2, 300), -1.0, 1.0), 7)
    return held.tolist()


@pytest.mark.parametrize("seed", range(6))
def test_mountain_car_moves_as_gymnasiums_to_the_last_bit(seed):
    env, plant = gymnasium.make("MountainCarContinuous-v0").unwrapped, Plant("mountain-car")
    first, _ = env.reset(seed=seed)
    [start] = starts("mountain-car", [seed])
    plant.reset(start)
    assert plant.observe(2).tolist() == first.tolist()
    for number, action in enumerate(push(seed)):
        if number % 100 == 99:  # to where speed and place meet their limits
            place = np.random.default_rng(number + seed).uniform((-1.2, -0.07), (0.44, 0.07))
            env.state = np.array(place, np.float32)
            plant.plants.state[:2, plant.lane] = env.state
        seen, reward, over, _, _ = env.step(np.array([action]))
        got_reward, bonus, got_over = plant.step([action])
        assert (plant.observe(2).tolist(), got_over) == (seen.tolist(), over)
        # The C library's square, of the action, may differ from a product in the last bit.
        assert (got_reward, bonus) == (pytest.approx(reward, rel=1e-15), 0.0)


@pytest.mark.parametrize("seed", range(6))
def test_cart_pole_is_gymnasiums_with_the_force_scaled(seed):
    env, plant = gymnasium.make("CartPole-v1").unwrapped, Plant("cart-pole")
    env.reset(seed=seed)
    [start] = starts("cart-pole", [seed])
    assert start.tolist() == env.state.tolist()
    plant.reset(start)
    rng = np.random.default_rng(seed)
    for action in push(seed):
        state = rng.uniform((-2.4, -3, -0.21, -3), (2.4, 3, 0.21, 3))
        env.state = state.copy()
        plant.plants.state[:, plant.lane] = state
        env.force_mag = 10.0 * action
        env.steps_beyond_terminated = None
        seen, reward, over, _, _ = env.step(1)
        assert plant.step([action]) == (reward, 0.0, over)
        # numpy's own cosine and the C library's may differ in the last bit.
        np.testing.assert_allclose(plant.plants.state[:, plant.lane], env.state, rtol=1e-14, atol=1e-16)
        assert plant.observe(2).tolist() == [float(np.float32(v)) for v in seen[2:]]


@pytest.mark.parametrize("seed", range(3))
def test_pendulum_is_gymnasiums_to_the_last_bit(seed):
    env, plant = gymnasium.make("InvertedPendulum-v5").unwrapped, Plant("pendulum")
    rng = np.random.default_rng(seed)
    for episode in range(5):
        first, _ = env.reset(seed=seed + 10 * episode)
        [start] = starts("pendulum", [seed + 10 * episode])
        assert start.tolist() == first.tolist()
        plant.reset(start)
        for _ in range(60):
            action = float(np.clip(4.0 * (first[1] + rng.normal(0, 0.02)), -0.3, 0.3))
            first, reward, over, _, _ = env.step(np.array([action]))
            got_reward, bonus, got_over = plant.step([action])
            assert plant.observe(2).tolist() == [first[1], first[0]]
            assert (got_reward, got_over) == (reward, over)
            assert bonus == (0.0 if over else 0.2 * (1.0 - abs(first[0])))
            if over:
                break


def test_roboschools_pendulum_is_the_same_plant_at_its_step_and_start():
    env, plant = gymnasium.make("InvertedPendulum-v5", frame_skip=1).unwrapped, Plant("roboschool")
    env.model.opt.timestep = 0.0165
    for seed in range(5):
        env.reset(seed=0)
        [start] = starts("roboschool", [seed])
        assert abs(start[1]) <= 0.1 and not start[[0, 2, 3]].any()
        env.set_state(start[:2], start[2:])
        plant.reset(start)
        for number in range(40):
            action = 0.3 * np.sin(number)
            seen, reward, over, _, _ = env.step(np.array([action]))
            got_reward, _, got_over = plant.step([action])
            assert plant.observe(2).tolist() == [seen[1], seen[0]]
            assert (got_reward, got_over) == (reward, over)
            if over:
                break


@pytest.mark.parametrize("seed", range(3))
def test_half_cheetah_is_gymnasiums_to_the_last_bit(seed):
    env, plant = gymnasium.make("HalfCheetah-v5").unwrapped, Plant("half-cheetah")
    first, _ = env.reset(seed=seed)
    [start] = starts("half-cheetah", [seed])
    plant.reset(start)
    assert plant.observe(17).tolist() == first.tolist()
    rng = np.random.default_rng(seed)
    for _ in range(200):
        action = rng.uniform(-1.0, 1.0, 6)
        seen, reward, _, _, _ = env.step(action)
        got_reward, bonus, over = plant.step(action)
        assert plant.observe(17).tolist() == seen.tolist()
        assert got_reward == pytest.approx(reward, rel=1e-13, abs=1e-13)
        assert (bonus, over) == (0.0, False)
