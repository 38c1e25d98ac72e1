"""Explanations of circuits on tasks that are no drives."""

import json
import re

import numpy as np
import pytest
from kit.paths import ROOT
from kit.tutorials import PAGES, write_files

from rover_ncp.cli import run
from rover_ncp.core.errors import ConfigError, UsageError
from rover_ncp.core.files import resolve
from rover_ncp.core.streams import Domain, episode_seeds
from sim.explain.files import page
from sim.explain.task import explain_task, stored_policy
from sim.explain.what_if import without_neuron
from sim.learn.engine.environment import EnvironmentEvaluator
from sim.paper.evaluator import Evaluator
from sim.paper.tasks import TASKS

[PAGE] = [page for page in PAGES if page.stem == "own_task"]


@pytest.fixture
def folder(tmp_path, monkeypatch):
    write_files(PAGE, tmp_path)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.long
def test_command_explains_a_policy_on_an_environment(folder, capsys):
    command = ["explain", "wall.yaml", "--task", "wall:FollowWall-v0", "--out", "why", "--json"]
    assert run(command) == 0
    said = capsys.readouterr()
    fields = json.loads(said.out)
    assert fields["simulated"]["enough"] == -10.0
    assert fields["simulated"]["return"] == pytest.approx(np.mean(fields["simulated"]["returns"]))
    assert {row["kind"] for row in fields["knock_outs"]} == {"neuron", "synapse"}
    assert len(fields["knock_outs"]) == 6 + 6
    labels = {phase["label"] for phase in fields["phases"]}
    assert labels <= {"turn positive", "turn negative", "turn about 0"}
    text = (folder / "why" / "explanation.html").read_text()
    assert "Policy wall on wall:FollowWall-v0" in text
    assert "rover-ncp explain wall.yaml --task wall:FollowWall-v0" in text


def test_a_knock_out_is_the_mean_return_of_the_same_episodes(folder, monkeypatch):
    monkeypatch.setattr("sim.explain.task.EPISODES", 2)
    found = explain_task("wall.yaml", "wall:FollowWall-v0")
    by_name = {row.name: row for row in found.knock_outs}
    lame = without_neuron(found.policy, "LEFT")
    returns = EnvironmentEvaluator("wall:FollowWall-v0", lame).returns(
        lame.parameters(), episode_seeds(0, Domain.EXPLAINED_EPISODES, 2)
    )
    assert by_name["LEFT"].total == pytest.approx(returns.mean())
    assert by_name["LEFT"].change == pytest.approx(returns.mean() - np.mean(found.simulated.returns))


def test_a_stored_circuit_of_the_paper_plays_as_it_is_scored():
    name, policy = stored_policy(TASKS["mountain-car"], ROOT / "results")
    assert name.startswith("paper run published mountain-car circuit")
    episodes = Evaluator(TASKS["mountain-car"], policy)
    seeds = np.array([5, 6], np.uint64)
    [returns] = episodes.returns(policy.parameters()[None], seeds)
    assert [episodes.play(int(seed)).rewards.sum() for seed in seeds] == pytest.approx(returns, abs=1e-9)
    assert returns.min() > TASKS["mountain-car"].success
    [blind] = episodes.of(without_neuron(policy, "FWD")).returns(policy.parameters()[None], seeds)
    assert not np.array_equal(blind, returns)


@pytest.mark.parametrize(
    ("source", "task", "error", "words"),
    [
        (
            "course",
            "mountain-car",
            ConfigError,
            "inputs are longitudinal, .*; mountain-car has position, velocity",
        ),
        ("course", "parking", UsageError, "without --task, with --course parking"),
        (None, "Pendulum-v1", UsageError, "an environment needs a policy"),
    ],
)
def test_what_cannot_be_explained_is_named(source, task, error, words):
    source = source and str(resolve("policies", source))
    with pytest.raises(error, match=words):
        explain_task(source, task)


def test_a_stored_parking_circuit_is_explained_as_a_drive(monkeypatch):
    monkeypatch.chdir(ROOT)
    for what_ifs in ("knock_outs", "sensitivities"):  # those of a drive have tests of their own
        monkeypatch.setattr(f"sim.explain.explain.{what_ifs}", lambda *_: ())
    found = explain_task(None, "parking")
    assert found.task is None
    assert found.verdict.parked
    assert {"FWD", "LFT", "RGT"} <= set(found.policy.circuit.neurons)
    assert found.command == "rover-ncp explain --task parking"


def test_the_paper_circuit_is_explained_in_words(monkeypatch):
    monkeypatch.chdir(ROOT)
    monkeypatch.setattr("sim.explain.task.EPISODES", 2)
    found = explain_task(None, "cart-pole")
    shown = page(found)
    assert "rover-ncp explain --task cart-pole" in shown
    assert "Action positive" in shown
    assert re.search(r"\[(angle|rate) (<|>|&lt;|&gt;) 0\]", shown)
    assert 'id="path-plot"' not in shown
    assert '"outputs":[["output0","action"]]' in shown
