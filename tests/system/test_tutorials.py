"""Every command and every file of the tutorials, in order, in a folder of a user."""

import os
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
from kit.tutorials import PAGES, steps, write_files

NEEDS_A_CLONE = "source .venv/bin/activate"
READY = ("listening on ", "ready ")
"""First words of a line by which a mock or a bridge is ready."""
COMMANDS = ("rover-ncp ", "python ", "sed ")


@pytest.fixture
def background():
    """Start a command and wait until it is ready; all of them end with the test."""
    started = []

    def start(line, folder, environment):
        process = subprocess.Popen(
            shlex.split(line), cwd=folder, env=environment,
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
        )  # fmt: skip
        started.append(process)
        said = []
        for words in process.stdout:
            said.append(words)
            if words.startswith(READY):
                return
        raise AssertionError((line, said))

    yield start
    for process in reversed(started):
        process.terminate()
        process.communicate(timeout=30)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_every_command_of_a_tutorial_runs(page, tmp_path, background):
    installed = tmp_path / "installed"  # not into the environment of the tests
    environment = {
        **os.environ,
        "PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}",
        "PYTHONPATH": str(installed),
    }
    write_files(page, tmp_path)
    ran = 0
    for name, content in steps(page):
        if name is not None:
            continue
        for line in content.splitlines():
            if line == NEEDS_A_CLONE:
                continue
            assert line.startswith(COMMANDS), line
            if line.endswith(" &"):
                background(line.removesuffix(" &"), tmp_path, environment)
                ran += 1
                continue
            own = line.replace("pip install", f"pip install --target {installed}")
            done = subprocess.run(
                own, shell=True, cwd=tmp_path, env=environment,
                capture_output=True, text=True, timeout=200, check=False,
            )  # fmt: skip
            assert done.returncode == 0, (line, done.stdout[-1500:], done.stderr[-1500:])
            ran += 1
    assert ran  # a page may have one command, but none means that its blocks were not found
