"""The fields of ``--json`` as commands print them, against the page of JSON results."""

import json
from importlib.metadata import entry_points

import pytest
from kit.json_fields import assert_on_page
from kit.paths import DATA
from kit.recorded_drives import write_drive
from kit.tutorials import PAGES, write_files
from result_fields import RESULTS

from rover_ncp import cli
from rover_ncp.cli import run

SHORT = str(DATA / "short_course.yaml")
STACK = ["eval --trials", "eval --trials --stack, besides"]
SEQUENCES = [
    {"course new aside.csv --out made.yaml": ["course"], "course check made.yaml": ["course"]},
    {f"eval parking --course {SHORT}": ["eval"]},
    {f"eval parking --course {SHORT} --trials 2 --randomize mild": ["eval --trials"]},
    {f"eval course --course {SHORT} --stack --trials 2": STACK},
    {"eval wall.yaml --task wall:FollowWall-v0 --trials 2": ["eval --task, an environment"]},
    {f"train --course {SHORT} --agents 1 --iterations 2 --processes 1 --out run": ["train"]},
    {
        f"train --randomize mild --course {SHORT} --iterations 1 --rollouts 2 --random-courses 0 --out run": [
            "train --randomize"
        ]
    },
    {
        "train --task wall:FollowWall-v0 --circuit wall.yaml --iterations 1 --rollouts 1 --out run": [
            "train --task"
        ]
    },
    {"export parking --to yaml --out mine": ["export"]},
    {"urdf p3at": ["urdf"]},
    {"recover drive.mcap": ["recover"], "report drive.mcap": ["report"]},
    {"keys --out keys": ["keys"]},
    {f"explain parking --course {SHORT} --out why": ["explain"]},
    {"explain wall.yaml --task wall:FollowWall-v0": ["explain"]},
    {"paper report": ["paper report"]},
]
"""Commands with the headings of their fields."""
UNSEEN = ("model", "profile")
UNSEEN += tuple(f"phases.{name}." for name in ("behind", "rival", "pulls", "change"))
"""Fields that are printed only with an option or an event that these commands lack."""


@pytest.mark.long
@pytest.mark.parametrize("commands", SEQUENCES, ids=lambda commands: next(iter(commands)).rsplit("/")[0])
def test_page_has_the_fields_that_a_command_prints(commands, tmp_path, monkeypatch, capsys):
    [page] = [page for page in PAGES if page.stem == "own_task"]
    write_files(page, tmp_path)
    write_drive(tmp_path / "drive.mcap", course=SHORT)
    (tmp_path / "aside.csv").write_text("x,y,theta\n0,0,0\n0,0.5,0\n")
    monkeypatch.chdir(tmp_path)
    for command, headings in commands.items():
        assert run([*command.split(), "--json"]) in (0, 1), command
        found = json.loads(capsys.readouterr().out)
        assert "error" not in found, (command, found)
        assert_on_page(found, *headings, unseen=(*UNSEEN, *(("run.",) if "--task" in command else ())))


def test_every_command_has_its_fields_on_the_page():
    commands = {heading.split()[0] for heading in RESULTS}
    assert commands == {point.name for point in entry_points(group=cli.GROUP)}
