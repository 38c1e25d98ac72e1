import json
import re
import shutil

import numpy as np
import pytest

from rover_ncp.circuit.policy_file import load_policy
from rover_ncp.cli import run
from rover_ncp.core.errors import FileError
from sim.explain.training import read_training, training_data, write_page
from sim.learn.record import TrainSettings
from sim.learn.rollout import rollout
from sim.learn.train import train

SHORT = "tests/data/short_course.yaml"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    out = tmp_path_factory.mktemp("train") / "run"
    train(TrainSettings(course=SHORT, seed=1, agents=3, iterations=150), out, processes=1)
    return out


def test_a_training_is_read_as_it_was_saved(folder):
    training = read_training(folder)
    assert [agent.number for agent in training.agents] == [0, 1, 2]
    assert [milestone.iterations for milestone in training.milestones] == [0, 100, 150]
    for agent in training.agents:
        policy = load_policy(folder / "agents" / f"{agent.number:02}.yaml")
        assert (agent.parameters == policy.parameters()).all()
        # What was saved as its return is what it drives now.
        assert agent.run.total == pytest.approx(agent.value_at(150), abs=1e-12)
    best = load_policy(folder / "policy.yaml")
    assert training.best.run.total == rollout(best, training.course).total
    assert training.milestones[-1].run.total == training.best.run.total


def test_the_page_shows_curves_drives_and_parameters(folder, tmp_path):
    page = write_page(folder, tmp_path / "page.html")
    assert page.kind == "training"
    text = page.path.read_text()
    data = json.loads(re.search(r'<script id="data" type="application/json">(.*?)</script>', text, re.S)[1])
    training = read_training(folder)
    table = np.genfromtxt(folder / "curve.csv", delimiter=",", skip_header=1)
    assert data["curves"]["iterations"] == table[:, 0].tolist()
    losses = np.array(data["curves"]["losses"]).T
    assert losses == pytest.approx(np.maximum(-table[:, 1:], 1e-4), abs=1e-4)
    assert data["curves"]["quartiles"][1] == pytest.approx(np.median(losses, axis=1), abs=1e-4)
    assert [row["iterations"] for row in data["milestones"]] == [0, 100, 150]
    assert data["milestones"][1]["x"] == pytest.approx(training.milestones[1].run.poses[:, 0], abs=1e-4)
    layout = training.policy.layout()
    assert [(p["lower"], p["upper"]) for p in data["parameters"]] == [
        (b.lower, b.upper) for b in layout.blocks
    ]
    for block, shown in zip(layout.blocks, data["parameters"], strict=True):
        assert len(shown["best"]) == len(shown["names"]) == block.size
        assert sum(shown["counts"]) == 3 * block.size
    assert len(page.path.read_bytes()) < 10_000_000


def test_unfinished_run_is_reported_as_far_as_it_got(folder, tmp_path):
    for part in ("agents/00.yaml", "agents/01.yaml", "agents/02.yaml", "curve.png", "milestones"):
        copy = tmp_path / "run"
        if not copy.exists():
            shutil.copytree(folder, copy)
        target = copy / part
        shutil.rmtree(target) if target.is_dir() else target.unlink()
    data = training_data(read_training(tmp_path / "run"))
    assert [row["iterations"] for row in data["milestones"]] == [150]


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda run: (run / "settings.yaml").unlink(), "holds no training run"),
        (lambda run: (run / "policy.yaml").unlink(), "has not saved anything yet"),
        (lambda run: (run / "agents/01.json").write_text("{"), "01.json: damaged"),
        (lambda run: (run / "agents/01.json").write_text('{"agent": 1}'), "01.json: damaged"),
        (lambda run: (run / "milestones/9x.yaml").write_text(""), "named for its iterations"),
    ],
)
def test_damaged_file_is_named(folder, tmp_path, spoil, words):
    shutil.copytree(folder, tmp_path / "run")
    spoil(tmp_path / "run")
    with pytest.raises(FileError, match=re.escape(words)):
        read_training(tmp_path / "run")


def test_command_writes_the_page_into_the_folder(folder, capsys):
    assert run(["report", str(folder), "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["page"] == str(folder / "report.html")
    assert said["kind"] == "training"
    # The run can still be continued.
    train(TrainSettings(course=SHORT, seed=1, agents=3, iterations=150), folder, processes=1, resume=True)
