"""The Gymnasium environment of a robot: any policy drives a real bridge and a mock, behind the gate."""

import signal
import subprocess
import sys

import gymnasium
import numpy as np
import pytest

import deploy.env
from rover_ncp.circuit.policy_file import load_policy
from rover_ncp.circuit.runner import Runner
from rover_ncp.core.errors import NoBridge
from sim.live.live_run import LiveRun
from sim.live.processes import wait_for
from sim.world.env import RoverParkingEnv

COURSE = """
name: short
start_signal_s: 0.5
horizon_s: 4.0
checkpoints:
- {t: 1.0, x: 0.0, y: 0.0, theta: 0.0}
- {t: 4.0, x: 0.2, y: 0.0, theta: 0.0}
"""


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    with LiveRun(tmp_path_factory.mktemp("live")) as run:
        yield run


@pytest.fixture
def course(tmp_path):
    path = tmp_path / "short.yaml"
    path.write_text(COURSE)
    return path


def environment(run, course, **options):
    return gymnasium.make("deploy.env:rover_ncp/Rover-v0", robot=run.robot, course=course, **options)


def stands(run):
    return lambda: abs(run.truth.speed()) < 0.001


def test_a_policy_of_ones_own_drives_the_rover_to_the_horizon(run, course):
    before = run.truth.read()[-1].pose
    env = environment(run, course)
    observation, _ = env.reset()
    assert observation.shape == (4,)
    assert env.observation_space.contains(observation)
    rewards, ended, steps = [], False, 0
    while not ended:
        action = np.array([0.1 if observation[0] < 0.15 else 0.0, 0.0])
        observation, gain, terminated, truncated, info = env.step(action)
        rewards.append(gain)
        ended, steps = terminated or truncated, steps + 1
    assert (terminated, info["stopped_by"]) == (True, None)
    assert 35 <= steps <= 40  # a busy machine may miss ticks
    assert info["time_s"] == pytest.approx(4.0)
    assert sum(gain != 0.0 for gain in rewards) == 2
    assert -0.1 < sum(rewards) < 0.0
    assert 0.1 < run.truth.read()[-1].pose.x - before.x < 0.25
    wait_for(stands(run), what="the rover to stand")
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.step(np.zeros(2))
    env.close()


def test_observations_are_the_signals_by_name(run, course):
    env = environment(run, course, signals=("longitudinal", "speed"))
    observation, _ = env.reset()
    assert observation.shape == (2,)
    env.close()


def test_exception_between_steps_stops_the_rover(run, course):
    env = environment(run, course)
    env.reset()
    for _ in range(8):
        env.step(np.array([0.1, 0.0]))
    wait_for(lambda: run.truth.speed() > 0.05, what="the rover to drive")
    wait_for(stands(run), 5.0, what="the rover to stand without actions")
    _, _, terminated, truncated, info = env.step(np.zeros(2))
    assert (terminated, truncated, info["stopped_by"]) == (False, True, "action-late")
    env.close()


def test_close_stops_the_rover_and_releases_the_lease(run, course):
    env = environment(run, course)
    env.reset()
    for _ in range(8):
        env.step(np.array([0.1, 0.0]))
    env.close()
    wait_for(stands(run), what="the rover to stand")
    again = environment(run, course)
    again.reset()  # another driver would be refused as long as the lease is held
    again.close()


def test_no_bridge_is_an_error_of_reset(course):
    env = deploy.env.RoverEnv("tcp/127.0.0.1:9", course)
    with pytest.raises(NoBridge):
        env.reset()


def test_spaces_are_those_of_the_simulator(course):
    robot, simulated = deploy.env.RoverEnv("tcp/127.0.0.1:9", course), RoverParkingEnv()
    assert robot.observation_space == simulated.observation_space
    assert robot.action_space == simulated.action_space
    assert Runner(load_policy("parking")).tick(simulated.reset()[0]) is not None


SCRIPT = """
import sys, gymnasium, numpy
env = gymnasium.make("deploy.env:rover_ncp/Rover-v0", robot=sys.argv[1], course=sys.argv[2])
env.reset()
print("driving", flush=True)
while True:
    env.step(numpy.array([0.1, 0.0]))
"""


@pytest.mark.long
def test_end_of_a_program_that_does_not_close_stops_the_rover(run, course):
    script = SCRIPT.replace("while True:", "for _ in range(8):")
    command = [sys.executable, "-c", script, run.robot, str(course)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=30, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    wait_for(stands(run), what="the rover to stand")
    again = environment(run, course)
    again.reset()  # the lease was released
    again.close()


def test_ctrl_c_in_a_program_stops_the_rover(run, course):
    course.write_text(course.read_text().replace("4.0", "30.0"))
    command = [sys.executable, "-c", SCRIPT, run.robot, str(course)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as program:
        assert program.stdout.readline() == "driving\n"
        wait_for(lambda: run.truth.speed() > 0.05, what="the rover to drive")
        program.send_signal(signal.SIGINT)
        assert program.wait(20) == -signal.SIGINT
    wait_for(stands(run), what="the rover to stand")
    again = environment(run, course)
    again.reset()  # the lease was released
    again.close()
