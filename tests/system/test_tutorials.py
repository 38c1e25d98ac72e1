"""Every command and every file of the tutorials, in order, in a folder of a user."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from paths import ROOT

TUTORIALS = sorted((ROOT / "docs" / "tutorials").glob("*.md"))
BLOCK = re.compile(r"^```(sh|yaml) ?(?:title=\"([^\"]+)\")?\n(.*?)^```", re.MULTILINE | re.DOTALL)
NEEDS_A_CLONE = "source .venv/bin/activate"


@pytest.mark.parametrize("page", TUTORIALS, ids=lambda page: page.stem)
def test_every_command_of_a_tutorial_runs(page, tmp_path):
    path = f"{Path(sys.executable).parent}:{os.environ['PATH']}"
    ran = 0
    for kind, name, content in BLOCK.findall(page.read_text()):
        if kind == "yaml":
            (tmp_path / name).write_text(content)
            continue
        for line in content.splitlines():
            if line == NEEDS_A_CLONE:
                continue
            done = subprocess.run(
                line, shell=True, cwd=tmp_path, env={**os.environ, "PATH": path},
                capture_output=True, text=True, timeout=200, check=False,
            )  # fmt: skip
            assert done.returncode == 0, (line, done.stdout[-1500:], done.stderr[-1500:])
            ran += 1
    assert ran >= 3


def test_the_tutorials_leave_no_command_out():
    for page in TUTORIALS:
        text = page.read_text()
        shown = len(re.findall(r"^ *rover-ncp ", text, re.MULTILINE))
        executed = sum(
            content.count("rover-ncp ") for kind, _, content in BLOCK.findall(text) if kind == "sh"
        )
        assert shown == executed, page
