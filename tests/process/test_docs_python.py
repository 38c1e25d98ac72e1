"""The examples of docs/python.md run as they stand, one after the other."""

import re

import pytest
from kit.paths import ROOT
from kit.recorded_drives import write_drive


@pytest.mark.long  # tests/unit/test_api.py holds the functions
def test_the_examples_of_the_python_page_run(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    write_drive(tmp_path / "runs" / "park" / "run.mcap")
    blocks = re.findall(r"```python\n(.*?)```", (ROOT / "docs" / "python.md").read_text(), re.DOTALL)
    names = {}
    for block in blocks:
        exec(block, names)
    assert names["result"].policy_path.is_file()
    assert (tmp_path / "policy.yaml").is_file()
    assert len(names["potentials_mV"]) == 12
    assert "'t', 'PVD'" in capsys.readouterr().out
    names["envs"].close()
