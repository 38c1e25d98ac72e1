"""The example that trains a circuit on any Gymnasium environment, with the files of its tutorial."""

from pathlib import Path
from runpy import run_path

import gymnasium
import numpy as np
import pytest
from kit.paths import ROOT
from kit.tutorials import PAGES, write_files

from rover_ncp.circuit.policy_file import load_policy

EXAMPLE = run_path(str(ROOT / "docs" / "examples" / "any_task.py"))
[PAGE] = [page for page in PAGES if page.stem == "own_task"]


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """The folder of a user who follows the tutorial."""
    write_files(PAGE, tmp_path)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)


@pytest.mark.usefixtures("folder")
def test_circuit_of_the_tutorial_learns_and_the_file_scores_the_same(capsys):
    assert Path("any_task.py").read_text() == (ROOT / "docs" / "examples" / "any_task.py").read_text()
    EXAMPLE["main"]("wall:FollowWall-v0", "wall.yaml", "12", "out.yaml")
    environment = gymnasium.make("wall:FollowWall-v0")
    before, after = (EXAMPLE["score"](environment, load_policy(name)) for name in ("wall.yaml", "out.yaml"))
    assert after > 0.6 * before  # returns are negative
    assert capsys.readouterr().out.splitlines()[-1] == f"out.yaml: return {after:.4g}, untrained {before:.4g}"


def test_the_largest_output_chooses_a_discrete_action():
    class Env(gymnasium.Env):
        observation_space = gymnasium.spaces.Box(-1.0, 1.0, (4,))
        action_space = gymnasium.spaces.Discrete(2, start=3)
        actions: list[int] = []  # noqa: RUF012

        def reset(self, *, seed=None, options=None):
            return np.zeros(4), {}

        def step(self, action):
            self.actions.append(action)
            return np.zeros(4), 1.0, len(self.actions) == 5, False, {}

    env, policy = Env(), load_policy("parking")
    assert EXAMPLE["play"](env, policy, 0) == 5.0
    assert set(env.actions) <= {3, 4}
