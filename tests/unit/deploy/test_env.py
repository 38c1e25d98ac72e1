"""The Gymnasium environment of a robot: its thread, exceptions and end, without a robot."""

import atexit
import threading
from types import SimpleNamespace
from unittest.mock import Mock

import gymnasium
import numpy as np
import pytest
from kit.virtual_drive import VirtualDrive, short_course

import deploy.env
from deploy.drive.rate_keeper import RateKeeper
from deploy.env import RoverEnv
from rover_ncp.core.errors import RoverNcpError
from rover_ncp.core.geometry import Pose
from rover_ncp.course.course import TICK_S
from rover_ncp.course.scoring import reward
from sim.world.env import RoverParkingEnv


class Env(RoverEnv):
    """An environment whose drive takes ``ticks`` actions and then raises ``error``, or waits to be closed."""

    def __init__(self, ticks, error=None):
        super().__init__("tcp/127.0.0.1:9")
        self.controller = SimpleNamespace(estimate=SimpleNamespace(pose=Pose(0.0, 0.0, 0.0)))
        self.ticks, self.failure, self.actions, self.ended = ticks, error, [], 0

    def _drive(self, handover, closing):
        keeper = RateKeeper(round(TICK_S * 1e9), 0)
        drive = SimpleNamespace(keeper=keeper, stop=None, verdict=None, reason="", estimate=None)
        handover.drive, handover.controller = drive, self.controller
        handover.reset()
        handover.tick([])  # the warm-up
        try:
            for _ in range(self.ticks):
                self.actions.append(handover.tick([0.0] * 4))
            if self.failure is not None:
                raise self.failure
            closing.wait()
            raise KeyboardInterrupt
        finally:
            self.ended += 1


@pytest.fixture
def registered(monkeypatch):
    """What is to be called at the end of the program."""
    calls = []
    monkeypatch.setattr(atexit, "register", calls.append)
    monkeypatch.setattr(atexit, "unregister", calls.remove)
    return calls


@pytest.mark.parametrize("error", [ValueError("a bug"), RoverNcpError("x"), OSError(5, "x")])
def test_exception_of_the_drive_is_one_of_reset_or_step_and_no_horizon(error):
    with pytest.raises(type(error)) as raised:
        Env(0, error).reset()
    assert raised.value is error
    env = Env(1, error)
    env.reset()
    with pytest.raises(type(error)) as raised:
        env.step(np.zeros(2))
    assert raised.value is error
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.step(np.zeros(2))


@pytest.mark.parametrize("action", [np.zeros(3), 0.1, "left", {}])
def test_action_that_is_none_stops_the_rover_at_once(action):
    env = Env(1)
    env.reset()
    with pytest.raises((ValueError, TypeError)):
        env.step(action)
    assert env.ended == 1
    assert env.actions[0] == (0.0, 0.0)


def test_open_drive_is_closed_at_the_end_of_the_program_and_a_closed_one_is_forgotten(registered):
    env = Env(1)
    assert registered == []
    env.reset()
    assert registered == [env.close]
    registered[0]()
    assert (env.ended, registered) == (1, [])
    env.reset()
    env.reset()
    assert (env.ended, registered) == (2, [env.close])
    env.close()
    env.close()
    assert (env.ended, registered) == (3, [])


def test_close_that_is_interrupted_can_be_repeated(monkeypatch):
    env = Env(1)
    env.reset()
    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(threading.Thread, "join", Mock(side_effect=KeyboardInterrupt))
        env.close()
    env.close()
    assert env.ended == 1


def test_reward_is_that_of_the_estimate_and_not_of_the_pose_that_is_steered():
    env = Env(2)
    env.reset()
    pose = env.controller.estimate.pose = Pose(1.0, 2.0, 0.3)
    env._handover.drive.keeper.index = env.course.ticks
    _, gain, *_ = env.step(np.zeros(2))
    env.close()
    assert gain == sum(reward(pose, checkpoint.pose) for checkpoint in env.course.checkpoints)


COURSE = short_course(0.2)
AHEAD = np.array([0.1, 0.0])


@pytest.fixture
def virtual(monkeypatch):
    """Have every environment drive the rover of one virtual bridge."""
    virtual = VirtualDrive()
    virtual.use_in(deploy.env, monkeypatch)
    return virtual


def environment(**options):
    return gymnasium.make("deploy.env:rover_ncp/Rover-v0", robot="virtual", course=COURSE, **options)


def test_policy_of_ones_own_drives_the_rover_to_the_horizon(virtual):
    env = environment()
    observation, _ = env.reset()
    assert observation.shape == (4,)
    assert env.observation_space.contains(observation)
    rewards, ended = [], False
    while not ended:
        action = AHEAD if observation[0] < 0.15 else np.zeros(2)
        observation, gain, terminated, truncated, info = env.step(action)
        rewards.append(gain)
        ended = terminated or truncated
    assert (terminated, info["stopped_by"]) == (True, None)
    assert len(rewards) == COURSE.ticks
    assert info["time_s"] == pytest.approx(COURSE.horizon_s)
    assert sum(gain != 0.0 for gain in rewards) == 1
    assert -0.1 < sum(rewards) < 0.0
    assert 0.1 < virtual.rover.pose.x < 0.25
    assert virtual.stands()
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.step(np.zeros(2))
    env.close()


@pytest.mark.parametrize("closed", [True, False])
def test_close_and_missing_actions_stop_the_rover_and_release_the_lease(virtual, closed):
    env = environment(signals=("longitudinal", "speed"))
    observation, _ = env.reset()
    assert observation.shape == (2,)
    for _ in range(8):
        env.step(AHEAD)
    assert virtual.rover.velocity.v > 0.05
    if closed:
        env.close()
    else:
        env.unwrapped._thread.join(5.0)
        assert virtual.stands()
        _, _, terminated, truncated, info = env.step(np.zeros(2))
        assert (terminated, truncated, info["stopped_by"]) == (False, True, "action-late")
    assert virtual.stands()
    assert virtual.link.gate.lease == 0
    env.close()
    again = environment()
    again.reset()  # another driver would be refused as long as the lease is held
    again.close()


def test_spaces_are_those_of_the_simulator():
    robot, simulated = RoverEnv("tcp/127.0.0.1:9"), RoverParkingEnv()
    assert robot.observation_space == simulated.observation_space
    assert robot.action_space == simulated.action_space
