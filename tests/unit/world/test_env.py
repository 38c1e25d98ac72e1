"""The Gymnasium environment: its contract, its reward, and what ends an episode."""

import subprocess
import sys
import textwrap

import gymnasium
import numpy as np
import pytest

from rover_ncp.core.errors import ConfigError
from rover_ncp.course.course import Checkpoint, Course, Obstacle, load_course
from sim.world.env import ENV_ID


def play(env, action_at):
    """Return all observations, rewards and infos of an episode."""
    observation, info = env.reset(seed=1)
    observations, rewards, infos, terminated = [observation], [], [info], False
    while not terminated:
        observation, reward, terminated, truncated, info = env.step(action_at(len(rewards)))
        assert not truncated
        observations.append(observation)
        rewards.append(reward)
        infos.append(info)
    return np.array(observations), np.array(rewards), infos


def constant(v, omega):
    return lambda tick: np.array([v, omega])


# Run in a process of its own: here other tests have imported the module.
VECTORISED = """
import gymnasium, numpy
from gymnasium.utils.env_checker import check_env
check_env(gymnasium.make("sim.world.env:rover_ncp/RoverParking-v0").unwrapped)
for mode in ("sync", "async"):
    envs = gymnasium.make_vec("sim.world.env:rover_ncp/RoverParking-v0", num_envs=2, vectorization_mode=mode)
    envs.reset(seed=1)
    seen = [envs.step(numpy.array([[0.16, 0.0], [0.16, 0.18]]))[0] for _ in range(40)][-1]
    envs.close()
    assert seen.shape == (2, 4) and seen[0, 0] > 0.4 and seen[0, 2] == 0.0 and seen[1, 2] > 0.4, seen
"""


def test_make_finds_the_environment_without_an_import_also_vectorised():
    program = "if __name__ == '__main__':\n" + textwrap.indent(VECTORISED, "    ")
    subprocess.run([sys.executable, "-W", "error", "-c", program], check=True, timeout=100)


def test_doing_nothing_misses_all_checkpoints_and_sees_the_start_signal_at_its_time():
    observations, rewards, infos = play(gymnasium.make(ENV_ID), constant(0.0, 0.0))
    course = load_course("parking")
    misses = [point.x**2 + point.y**2 + point.theta**2 for point in course.checkpoints]
    assert rewards.sum() == pytest.approx(-sum(misses))
    assert rewards.sum() == pytest.approx(-14.18, abs=0.005)  # measured with the published simulator
    assert len(rewards) == 320
    assert not observations[:, :3].any()
    signal = observations[:, 3]
    assert not signal[:30].any()
    assert signal[30:].all()
    assert infos[30]["time_s"] == pytest.approx(3.0)


def test_headings_are_missed_by_the_shorter_way_round():
    ahead = Checkpoint(t=0.1, x=0.0, y=0.0, theta=6.0)
    course = Course(name="turned", start_signal_s=0.0, horizon_s=0.1, checkpoints=(ahead,))
    _, rewards, _ = play(gymnasium.make(ENV_ID, course=course), constant(0.0, 0.0))
    assert rewards.tolist() == [pytest.approx(-((2 * np.pi - 6.0) ** 2))]


def test_commands_beyond_the_box_count_as_its_ends():
    far, _, _ = play(gymnasium.make(ENV_ID, disable_env_checker=True).unwrapped, constant(3.0, -9.0))
    end, _, _ = play(gymnasium.make(ENV_ID), constant(0.16, -0.18))
    assert np.array_equal(far, end)
    assert far[-1, 0] != 0.0


def test_collision_is_reported_and_does_not_end_the_episode():
    wall = Obstacle(x=1.0, y=0.0, length=0.2, width=2.0)
    course = load_course("parking").model_copy(update={"obstacles": (wall,)})
    observations, rewards, infos = play(gymnasium.make(ENV_ID, course=course), constant(0.16, 0.0))
    assert len(rewards) == 320
    assert not infos[0]["touched"]
    assert infos[-1]["touched"]
    assert observations[-1, 0] == pytest.approx(0.9 - 0.313, abs=0.002)


def test_a_blocked_start_is_refused():
    block = Obstacle(x=0.4, y=0.2, length=0.3, width=0.1)
    course = load_course("parking").model_copy(update={"obstacles": (block,)})
    with pytest.raises(ConfigError, match="course parking: an obstacle stands where the rover starts"):
        gymnasium.make(ENV_ID, course=course)
