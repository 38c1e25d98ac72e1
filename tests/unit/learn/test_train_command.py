"""The train command in this process: what it prints, and what it refuses."""

import json
from pathlib import Path

import pytest
from kit.paths import DATA, content

from rover_ncp.circuit.policy_file import load_policy
from rover_ncp.cli import run

COURSE = DATA / "short_course.yaml"
TRAIN = f"train --course {COURSE} --processes 1"
QUICK = f"{TRAIN} --agents 2 --iterations 20"


def test_json_is_one_object_with_the_result(tmp_path, capsys):
    assert run(f"{QUICK} --seed 4 --out {tmp_path}/run --json".split()) == 0
    printed = capsys.readouterr()
    fields = json.loads(printed.out)
    assert (printed.out.count("\n"), printed.err) == (1, "")
    assert (fields["seed"], fields["agents"], fields["iterations"]) == (4, 2, 20)
    assert fields["best_return"] == max(fields["returns"])
    assert fields["median_return"] == pytest.approx(sum(fields["returns"]) / 2)
    assert 0 < fields["wall_s"] < 120
    assert load_policy(fields["policy"]).provenance["return"] == fields["best_return"]


@pytest.mark.parametrize(
    "command", [QUICK, f"{TRAIN} --randomize mild --rollouts 2 --random-courses 0 --iterations 1"]
)
def test_runs_without_a_folder_are_numbered(command, tmp_path, monkeypatch, run_json):
    monkeypatch.chdir(tmp_path)
    Path("runs/train-1").mkdir(parents=True)
    code, fields = run_json(command)
    assert (code, fields["policy"]) == (0, "runs/train-2/policy.yaml")


def test_resume_needs_no_options_and_refuses_others(tmp_path, capsys):
    out = f"--out {tmp_path}/run"
    assert run(f"{QUICK} {out}".split()) == 0
    before = content(tmp_path)
    assert run(f"train {out} --resume".split()) == 0
    assert content(tmp_path) == before
    assert run(f"train {out} --resume --seed 9 --agents 2".split()) == 2
    assert "--seed was 0 when this run began, now 9" in capsys.readouterr().err
    assert content(tmp_path) == before
