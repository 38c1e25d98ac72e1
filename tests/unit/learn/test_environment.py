"""Circuits on Gymnasium environments: the episodes are the environment's own, and misfits are named."""

from dataclasses import replace
from pathlib import Path

import gymnasium
import numpy as np
import pytest
from kit.tutorials import PAGES, write_files

from rover_ncp.circuit.policy_file import load_policy
from rover_ncp.circuit.runner import Runner
from rover_ncp.core.errors import ConfigError, UsageError
from sim.learn.engine.environment import MAX_STEPS, EnvironmentEvaluator
from sim.learn.environment_run import train_task
from sim.learn.record import TaskSettings
from sim.learn.search.base import draw_seeds

[PAGE] = [page for page in PAGES if page.stem == "own_task"]
TASK = "wall:FollowWall-v0"


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    """The folder of a user who followed the tutorial."""
    write_files(PAGE, tmp_path)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def policy(folder):
    return load_policy(folder / "wall.yaml")


def plain_return(policy, environment, seed, choose=lambda outputs: np.array(outputs, np.float32)):
    """The return of one episode, written as Gymnasium's documentation does it."""
    runner = Runner(policy)
    seen, _ = environment.reset(seed=int(seed) % 2**32)
    total, over = 0.0, False
    while not over:
        seen, reward, terminated, truncated, _ = environment.step(choose(runner.tick(seen.tolist())))
        total, over = total + reward, terminated or truncated
    return total


def test_returns_are_those_of_one_episode_after_the_other(policy):
    evaluator = EnvironmentEvaluator(TASK, policy)
    vectors = np.array([policy.parameters(), 0.9 * policy.parameters()])
    vectors[1] = np.clip(vectors[1], policy.layout().lower, policy.layout().upper)
    seeds = draw_seeds(3, (), 20)  # more episodes than lanes
    found = evaluator.returns(vectors, seeds)
    environment = gymnasium.make("FollowWall-v0")
    for vector, row in zip(vectors, found, strict=True):
        own = policy.with_parameters(vector)
        assert row.tolist() == [plain_return(own, environment, seed) for seed in seeds]
    assert evaluator.play(int(seeds[0])).rewards.sum() == pytest.approx(found[0, 0])
    assert np.array_equal(evaluator.of(own).returns(vectors[1], seeds), found[1:])


def test_the_largest_output_chooses_a_discrete_action(policy):
    sensing, motors = policy.sensing, policy.motors
    names = ("x", "v", "angle", "rate")
    pairs = (("FAR", "NEAR"), ("AWAY", "TOWARDS"))
    channels = [
        sensing.channels[i % 2].model_copy(
            update={"name": name, "positive": pairs[i % 2][i // 2], "negative": None, "minimum": None}
        )
        for i, name in enumerate(names)
    ]
    turn = motors.channels[0]
    outputs = [
        turn.model_copy(update={"name": name, "positive": neuron, "negative": None, "minimum": None})
        for name, neuron in (("left", "LEFT"), ("right", "RIGHT"))
    ]
    cart = replace(
        policy,
        sensing=sensing.model_copy(update={"inputs": names, "channels": tuple(channels)}),
        motors=motors.model_copy(update={"outputs": ("left", "right"), "channels": tuple(outputs)}),
    )
    seeds = draw_seeds(0, (), 3)
    [found] = EnvironmentEvaluator("CartPole-v1", cart).returns(cart.parameters(), seeds)
    environment = gymnasium.make("CartPole-v1")
    assert found.tolist() == [
        plain_return(cart, environment, seed, lambda outputs: int(np.argmax(outputs))) for seed in seeds
    ]


def test_what_does_not_fit_is_named(policy):
    with pytest.raises(ConfigError, match=r"observation has 3 entries, the policy inputs far, heading"):
        EnvironmentEvaluator("Pendulum-v1", policy)
    with pytest.raises(ConfigError, match=r"action needs 2 outputs, the policy has turn"):
        EnvironmentEvaluator("CartPole-v1", policy)
    with pytest.raises(ConfigError, match="must be a Box of one row, got Discrete"):
        EnvironmentEvaluator("FrozenLake-v1", policy)
    with pytest.raises(UsageError, match=r"environment Nowhere-v0: .*doesn't exist"):
        EnvironmentEvaluator("Nowhere-v0", policy)
    with pytest.raises(UsageError, match="no_such_module"):
        EnvironmentEvaluator("no_such_module:Nowhere-v0", policy)


class Endless(gymnasium.Env):
    """Never ends, or shows NaN."""

    observation_space = gymnasium.spaces.Box(-1.0, 1.0, (2,))
    action_space = gymnasium.spaces.Box(-1.0, 1.0, (1,))

    def __init__(self, shown=0.0):
        self.shown = shown

    def reset(self, *, seed=None, options=None):
        return np.zeros(2, np.float32), {}

    def step(self, action):
        return np.full(2, self.shown, np.float32), 0.0, False, False, {}


def test_an_environment_that_goes_wrong_is_named(policy, monkeypatch):
    monkeypatch.setattr("sim.learn.engine.environment.MAX_STEPS", 50)
    for name, shown, words in (
        ("Endless-v0", 0.0, "has not ended after 50 steps"),
        ("Nan-v0", np.nan, "not finite"),
    ):
        gymnasium.register(name, Endless, kwargs={"shown": shown}, disable_env_checker=True)
        with pytest.raises(ConfigError, match=words):
            EnvironmentEvaluator(name, policy).returns(policy.parameters(), draw_seeds(0, (), 1))
    assert MAX_STEPS > 1000


def test_training_is_the_same_after_an_interruption_which_loses_no_generation(folder):
    seen, settings = [], TaskSettings(task=TASK, circuit="wall.yaml", rollouts=2, iterations=4)
    whole = train_task(settings, Path("whole"), processes=1)

    def interrupt(generation):
        seen.append(generation.iterations)
        if seen == [1, 2]:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train_task(settings, Path("parts"), processes=1, on_generation=interrupt)
    train_task(settings, Path("parts"), processes=1, resume=True, on_generation=interrupt)
    assert seen == [1, 2, 3, 4]
    for name in ("policy.yaml", "curve.csv", "search.json", "settings.yaml"):
        assert (folder / "parts" / name).read_bytes() == (folder / "whole" / name).read_bytes(), name
    assert load_policy(whole.path).sensing.inputs == ("far", "heading")
