"""The example that trains a circuit on any Gymnasium environment, with the files of its tutorial."""

from runpy import run_path

import gymnasium
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
    wall = gymnasium.make("wall:FollowWall-v0").spec.entry_point
    gymnasium.register("BriefWall-v0", wall, max_episode_steps=10)
    EXAMPLE["main"]("BriefWall-v0", "wall.yaml", "1", "out.yaml")
    environment = gymnasium.make("BriefWall-v0")
    before, after = (EXAMPLE["score"](environment, load_policy(name)) for name in ("wall.yaml", "out.yaml"))
    assert after > before
    assert capsys.readouterr().out.splitlines()[-1] == f"out.yaml: return {after:.4g}, untrained {before:.4g}"


@pytest.mark.long
def test_circuit_of_the_paper_solves_mountain_car(tmp_path):
    out = tmp_path / "car.yaml"
    start = ROOT / "docs" / "tutorials" / "mountain_car.yaml"
    EXAMPLE["main"]("MountainCarContinuous-v0", start, "2", out)
    assert EXAMPLE["score"](gymnasium.make("MountainCarContinuous-v0"), load_policy(str(out)), 20) >= 90.0
