"""The tables in the documentation are those that the commands print of the shipped runs."""

from pathlib import Path

import pytest

from rover_ncp import cli

PAGE = Path("docs/paper.md")


@pytest.mark.parametrize("what", ["policy-gradients", "networks", "time-constants", "contributions"])
def test_the_page_has_the_table_that_the_command_prints(what, tmp_path, capsys):
    assert cli.run(["paper", what, "--runs", str(tmp_path)]) == 0
    table = capsys.readouterr().out.strip()
    assert table.count("\n") > 5
    assert table in PAGE.read_text(), f"rover-ncp paper {what} prints another table now"
