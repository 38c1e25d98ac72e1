"""Files of each version (tests/data/formats/README.md) are read, or refused in one line."""

import shutil

import pytest
from kit.paths import DATA

from rover_ncp.cli import run

VERSIONS = sorted(path.name for path in (DATA / "formats").iterdir() if path.is_dir())
SHORT = DATA / "short_course.yaml"
READ = [
    "recover drive.mcap --out whole.mcap",
    "report drive.mcap",
    "course new drive.mcap --name mine --out mine.yaml",
    "export train/policy.yaml --to c --out exported",
    "export randomized/policy.yaml --to yaml --out exported",
]
"""Commands that every version runs."""
READ_OR_REFUSED = [
    "replay drive.mcap",
    "train --resume --out train",
]
"""Commands that have to compute what the other version computed."""
SLOW = "train --resume --out randomized"


@pytest.mark.parametrize("command", [*READ, *READ_OR_REFUSED, pytest.param(SLOW, marks=pytest.mark.long)])
@pytest.mark.parametrize("version", VERSIONS)
def test_files_of_a_version_are_read_or_refused_in_one_line(version, command, tmp_path, monkeypatch, capfd):
    shutil.copytree(DATA / "formats" / version, tmp_path, dirs_exist_ok=True)
    shutil.copy(SHORT, tmp_path)
    monkeypatch.chdir(tmp_path)
    code = run(command.split())
    printed = capfd.readouterr().err
    assert "Traceback" not in printed
    assert code in {0, 1} or (command not in READ and code == 2 and printed.count("\n") == 1), printed
