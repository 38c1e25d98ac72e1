"""Plants against Gymnasium's environments, step by step."""

import ctypes

import gymnasium
import numpy as np
import pytest

from paper import episodes
from paper.episodes import PlantEvaluator
from paper.tasks import TASKS, build_agent, draw_seeds
from rover_ncp.core.errors import UsageError


class Plant:
    """One plant in a lane, stepped from Python."""

    def __init__(self, name, *, for_search=False):
        task = TASKS[name].model_copy(update={"horizon": 10**9})
        self.lanes = PlantEvaluator(task, task.policy(), for_search=for_search)
        self.state = self.lanes.state[0]
        self.pool = self.lanes.pool

    def reset(self, start):
        self.lanes.episodes.episode[0] = -1
        self.lanes.episodes.running = 0
        self.results = self.lanes.queue(np.array([start], float))
        self.advance()

    def advance(self):
        """Take the commands of all lanes, and observe."""
        started = np.zeros(1 + 2 * episodes.LANES, np.int64)
        episodes.library().step_episodes(
            ctypes.byref(self.lanes.episodes), ctypes.c_void_p(started.ctypes.data)
        )

    def observe(self):
        return self.lanes.observations[:, 0].tolist()

    def step(self, *commands):
        """Return reward, bonus, and whether the episode has ended."""
        self.lanes.commands[:, 0] = commands
        self.results[:] = 0.0
        self.advance()
        return (*self.results[0, :2].tolist(), self.lanes.episodes.episode[0] < 0)


def start_of(name, seed):
    return TASKS[name].start(np.random.Generator(np.random.PCG64(seed)))


def push(seed):
    """Return actions that hold for some steps, so that plants get far: -1, 1 or anything between."""
    rng = np.random.default_rng(seed)
    return np.repeat(np.clip(rng.normal(0.0, 1.2, 300), -1.0, 1.0), 7).tolist()


@pytest.mark.parametrize("seed", range(2))
def test_mountain_car_moves_as_gymnasiums_to_the_last_bit(seed):
    env, plant = gymnasium.make("MountainCarContinuous-v0").unwrapped, Plant("mountain-car")
    first, _ = env.reset(seed=seed)
    plant.reset(start_of("mountain-car", seed))
    assert plant.observe() == first.tolist()
    for number, action in enumerate(push(seed)):
        if number % 100 == 99:  # to where speed and place meet their limits
            place = np.random.default_rng(number + seed).uniform((-1.2, -0.07), (0.44, 0.07))
            env.state = np.array(place, np.float32)
            plant.state[:] = env.state
        seen, reward, over, _, _ = env.step(np.array([action]))
        got_reward, bonus, got_over = plant.step(action)
        assert (plant.state.tolist(), got_over) == (seen.tolist(), over)
        assert over or plant.observe() == seen.tolist()
        # The C library's square, of the action, may differ from a product in the last bit.
        assert (got_reward, bonus) == (pytest.approx(reward, rel=1e-15), 0.0)
        if over:
            env.reset(seed=seed)
            plant.reset(start_of("mountain-car", seed))


def test_cart_pole_is_gymnasiums_with_the_force_scaled():
    env, plant = gymnasium.make("CartPole-v1").unwrapped, Plant("cart-pole")
    for seed in range(6):
        env.reset(seed=seed)
        assert start_of("cart-pole", seed).tolist() == env.state.tolist()
    plant.reset(env.state)
    rng = np.random.default_rng(0)
    for action in push(0):
        env.state = plant.state[:] = rng.uniform((-2.4, -3, -0.21, -3), (2.4, 3, 0.21, 3))
        env.force_mag = 10.0 * action
        env.steps_beyond_terminated = None
        seen, reward, over, _, _ = env.step(1)
        assert plant.step(action) == (reward, 0.0, over)
        # numpy's own cosine and the C library's may differ in the last bit.
        np.testing.assert_allclose(plant.state, env.state, rtol=1e-14, atol=1e-16)
        assert over or plant.observe() == [float(np.float32(v)) for v in seen[2:]]
        if over:
            plant.reset(env.state)


def test_pendulum_is_gymnasiums_to_the_last_bit():
    env, plant = gymnasium.make("InvertedPendulum-v5").unwrapped, Plant("pendulum")
    rng = np.random.default_rng(0)
    for seed in range(10):
        seen, _ = env.reset(seed=seed)
        start = start_of("pendulum", seed)
        assert start.tolist() == seen.tolist()
        plant.reset(start)
        for _ in range(60):
            action = float(np.clip(4.0 * (seen[1] + rng.normal(0, 0.02)), -0.3, 0.3))
            seen, reward, over, _, _ = env.step(np.array([action]))
            bonus = 0.0 if over else 0.2 * (1.0 - abs(seen[0]))
            assert plant.step(action) == (reward, bonus, over)
            assert plant.observe() == [seen[1], seen[0]]
            if over:
                break


def test_written_pendulum_is_mujocos_up_to_rounding_and_ends_at_the_slider():
    written, mujoco = Plant("pendulum", for_search=True), Plant("pendulum")
    assert not mujoco.pool.model.geom_contype.any()
    rng = np.random.default_rng(0)
    compared, at_the_end, started = 0, 0, False
    for action in push(1) + push(2):
        if not started:
            start = rng.uniform(-1.0, 1.0, 4) * (0.9, 0.19, 1.0, 1.0)
            written.reset(start)
            mujoco.reset(start)
        got, expected = written.step(0.3 * action), mujoco.step(0.3 * action)
        if abs(written.state[0]) > 1.0:
            assert got == (0.0, 0.0, True)  # MuJoCo's episode may go on
            at_the_end += 1
        else:
            assert got == (expected[0], pytest.approx(expected[1], abs=1e-10), expected[2])
            np.testing.assert_allclose(written.state, mujoco.state, rtol=0, atol=1e-10)
            assert got[2] or written.observe() == written.state[[1, 0]].tolist()
            compared += 1
        started = not got[2]
    assert compared > 2000
    assert at_the_end > 5


def test_half_cheetah_is_gymnasiums_to_the_last_bit():
    env, plant = gymnasium.make("HalfCheetah-v5").unwrapped, Plant("half-cheetah")
    first, _ = env.reset(seed=0)
    plant.reset(start_of("half-cheetah", 0))
    assert plant.observe() == first.tolist()
    rng = np.random.default_rng(0)
    for _ in range(200):
        action = rng.uniform(-1.0, 1.0, 6)
        seen, reward, _, _, _ = env.step(action)
        assert plant.step(*action) == (pytest.approx(reward, rel=1e-13, abs=1e-13), 0.0, False)
        assert plant.observe() == seen.tolist()


@pytest.mark.parametrize("name", ["cart-pole", "pendulum", "half-cheetah"])
def test_an_episode_depends_neither_on_its_lane_nor_on_the_others(name):
    task = TASKS[name].model_copy(update={"horizon": 100})
    agent = build_agent(task, "mlp", 0)
    vectors = np.random.default_rng(3).normal(0.0, 0.7, (40, sum(agent.sizes)))
    seeds = draw_seeds(0, (1,), len(vectors))
    together = PlantEvaluator(task, agent).run(vectors, seeds)
    alone = PlantEvaluator(task, agent).run(vectors[7:9], seeds[7:9])
    assert alone.tolist() == together[7:9].tolist()
    assert len(set(together[:, 2 if name != "half-cheetah" else 0].tolist())) > 1


def test_without_a_compiler_an_error_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setattr(episodes, "BUILD", tmp_path / "build")
    monkeypatch.setattr(episodes, "COMPILE", ("no-such-cc",))
    with pytest.raises(UsageError, match="install gcc"):
        episodes.library.__wrapped__()
