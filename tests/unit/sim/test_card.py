"""``eval --card``: the card of a policy from outside says what was measured, and how to measure it again."""

import hashlib
from dataclasses import replace
from pathlib import Path

import pytest

from rover_ncp.circuit.policy_file import load_policy, save_policy
from sim.evaluate import card

ROBOTS = {"nominal": {"trials": 1, "randomize": "none"}, "some": {"randomize": "mild"}}


@pytest.fixture(autouse=True)
def few(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(card, "TRIALS", 4)
    monkeypatch.setattr(card, "ROBOTS", ROBOTS)
    monkeypatch.setattr(card, "COURSES", {"mirrored": {"course": ["mirrored"], "randomize": "full"}})


def test_each_row_is_measured_again_by_its_command_and_the_page_names_file_and_training(run_json):
    made = {"command": "rover-ncp train --seed 3", "settings": {"course": "bay", "randomize": "far"}}
    save_policy("own.yaml", replace(load_policy("course"), provenance=made))
    code, found = run_json("eval own.yaml --card")
    assert (code, found["card"]) == (0, "own.card.md")
    page = Path("own.card.md").read_text()
    assert hashlib.sha256(Path("own.yaml").read_bytes()).hexdigest() in page
    assert "`rover-ncp train --seed 3`" in page
    assert "| search | CMA-ES on random robots |" in page
    rows = {row["condition"]: row for row in found["rows"]}
    assert [*rows] == ["nominal", "some", "`far`: as trained", "mirrored"]
    assert " --course bay " in rows["`far`: as trained"]["command"]
    for row in rows.values():
        assert f"| {row['condition']} | " in page
        again = run_json(row["command"].removeprefix("rover-ncp "))[1]
        assert {name: again[name] for name in row["found"]} == row["found"]
