"""The Gymnasium environment of a robot: its thread, exceptions and end, without a robot."""

import atexit
import threading
from types import SimpleNamespace

import gymnasium
import numpy as np
import pytest

from deploy.drive.rate_keeper import RateKeeper
from deploy.env import RoverEnv
from rover_ncp.core.errors import RoverNcpError
from rover_ncp.core.geometry import Pose
from rover_ncp.course.course import TICK_S, reward


class Drive:
    """A drive that is as far as its first tick."""

    def __init__(self):
        self.keeper, self.stop, self.verdict, self.reason = RateKeeper(round(TICK_S * 1e9), 0), None, None, ""
        self.estimate = None


class Env(RoverEnv):
    """An environment whose drive takes ``ticks`` actions and then raises ``error``, or waits to be closed."""

    def __init__(self, ticks, error=None):
        super().__init__("tcp/127.0.0.1:9")
        self.controller = SimpleNamespace(estimate=SimpleNamespace(pose=Pose(0.0, 0.0, 0.0)))
        self.ticks, self.failure, self.actions, self.ended = ticks, error, [], 0

    def _drive(self, handover, closing):
        handover.drive, handover.controller = Drive(), self.controller
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
    env = Env(2)
    env.reset()
    with pytest.raises((ValueError, TypeError)):
        env.step(action)
    assert env.ended == 1
    assert env.actions[0] == (0.0, 0.0)


def test_open_drive_is_closed_at_the_end_of_the_program_and_a_closed_one_is_forgotten(registered):
    env = Env(2)
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
    env = Env(2)
    env.reset()

    def interrupted(thread, timeout=None):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(threading.Thread, "join", interrupted)
        with pytest.raises(KeyboardInterrupt):
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
