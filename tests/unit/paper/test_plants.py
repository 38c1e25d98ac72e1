"""Plants in lanes against Gymnasium's environments, step by step."""

import gymnasium
import numpy as np
import pytest

from sim.paper.mujoco_plants import MujocoPool
from sim.paper.pendulum import step_pendulum
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


@pytest.mark.parametrize("name", ["pendulum", "roboschool"])
def test_the_written_pendulum_is_mujocos_up_to_rounding_wherever_the_cart_may_be(name):
    task = TASKS[name]
    plant, step_s, frames = task.stand_in
    written = allocate_plants(plant, 1, task.bonus, step_s=step_s, frames=frames)
    mujoco = Plant(name, lanes=1, lane=0)
    assert mujoco.pool.lanes.dt_s == step_s * frames
    assert not mujoco.pool.model.geom_contype.any()
    rng = np.random.default_rng(0)
    compared, at_the_end, started = 0, 0, False
    for action in push(1) + push(2):
        if not started:
            start = rng.uniform(-1.0, 1.0, 4) * (0.9, 0.19, 1.0, 1.0)
            reset_plant(written, 0, start)
            mujoco.reset(start)
        commands = np.array([[0.3 * action]])
        got, expected = step_plant(written, 0, commands), mujoco.step(commands[0])
        if abs(written.state[0, 0]) > 1.0:
            assert got == (0.0, 0.0, True)  # whatever MuJoCo's says
            at_the_end += 1
        else:
            assert got == (expected[0], pytest.approx(expected[1], abs=1e-10), expected[2])
            seen = np.zeros((2, 1))
            observe(written, 0, seen)
            np.testing.assert_allclose(seen[:, 0], mujoco.observe(2), rtol=0, atol=1e-10)
            qvel = mujoco.pool.data[0].qvel
            np.testing.assert_allclose(written.state[2:, 0], qvel, rtol=0, atol=1e-10)
            compared += 1
        started = not got[2]
    assert compared > 2000
    assert at_the_end > 5


def test_steered_alike_the_written_pendulum_stays_mujocos_for_a_whole_episode():
    state = np.zeros((4, 1))
    pool = MujocoPool("inverted_pendulum.xml", 2, 1)
    [data] = pool.data
    data.qpos[1] = state[1] = 0.05
    lanes = allocate_plants(TASKS["pendulum"].plant, 1, 0.0, pool.lanes)

    def steer(x, angle, speed, rate, noise):
        return float(np.clip(7.3 * angle + 1.1 * rate + x + 1.2 * speed + noise, -0.3, 0.3))

    for noise in np.random.default_rng(5).normal(0.0, 0.03, 1000):
        step_plant(lanes, 0, np.array([[steer(*data.qpos, *data.qvel, noise)]]))
        assert not step_pendulum(state, 0, 0.02, 2, steer(*state[:, 0], noise))
        np.testing.assert_allclose(state[:, 0], [*data.qpos, *data.qvel], rtol=0, atol=1e-12)


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
