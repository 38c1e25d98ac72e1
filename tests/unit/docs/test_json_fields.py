"""The fields of ``--json`` as commands print them, against their description in docs/cli.md."""

import json
import re

import pytest
from paths import DATA, ROOT
from recorded_drives import write_drive
from tutorials import PAGES, write_files

from rover_ncp.cli import run

SHORT = str(DATA / "short_course.yaml")
PAGE = (ROOT / "docs" / "cli.md").read_text()
SECTIONS = dict(re.findall(r"^## (\w+)\n(.*?)(?=^## |\Z)", PAGE, re.MULTILINE | re.DOTALL))
BY_NAME = {"commits", "ended", "failures", "ranges", "circuits", "std", "tasks", "best"}
"""Fields whose own keys are names: of reasons, neurons and the like."""
SEQUENCES = [
    [f"course check {SHORT}", "course new poses.yaml --out made.yaml"],
    [f"eval parking --course {SHORT}", f"eval parking --course {SHORT} --trials 2 --randomize mild"],
    [f"eval course --course {SHORT} --stack --trials 2"],
    ["eval wall.yaml --task wall:FollowWall-v0 --trials 2"],
    [f"train --course {SHORT} --agents 1 --iterations 2 --processes 1 --out run", "report run"],
    [f"train --randomize mild --course {SHORT} --iterations 1 --rollouts 2 --random-courses 0 --out run"],
    ["train --task wall:FollowWall-v0 --circuit wall.yaml --iterations 1 --rollouts 1 --out run"],
    ["export parking --to yaml --out mine", "urdf p3at", "recover drive.mcap"],
    [f"explain parking --course {SHORT}", "explain wall.yaml --task wall:FollowWall-v0", "report drive.mcap"],
    [f"paper {what}" for what in ("status", "networks", "parameters", "time-constants", "contributions")],
]


def fields(value):
    """Yield the keys of an object and of those in it."""
    if isinstance(value, list):
        for item in value:
            yield from fields(item)
    elif isinstance(value, dict):
        for key, inner in value.items():
            yield key
            if key not in BY_NAME:
                yield from fields(inner)


@pytest.mark.parametrize("commands", SEQUENCES, ids=lambda commands: commands[0].split()[0])
def test_every_field_that_a_command_prints_is_described(commands, tmp_path, monkeypatch, capsys):
    [page] = [page for page in PAGES if page.stem == "own_task"]
    write_files(page, tmp_path)
    write_drive(tmp_path / "drive.mcap", course=SHORT)
    poses = "poses:\n- {x: 0.0, y: 0.0, theta: 0.0}\n- {x: 0.5, y: 0.0, theta: 0.0}\n"
    (tmp_path / "poses.yaml").write_text(poses)
    monkeypatch.chdir(tmp_path)
    for command in commands:
        assert run([*command.split(), "--json"]) in (0, 1), command
        found = json.loads(capsys.readouterr().out)
        assert "error" not in found, (command, found)
        described = set(re.findall(r"`([^`]+)`", SECTIONS[command.split()[0]]))
        missing = {key for key in fields(found) if key not in described}
        assert not missing, (command, missing)
