"""Commands in a folder whose files have the names of our packages and libraries: none of them is imported.

The same holds for an installed wheel: tests/system/test_install.py.
"""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

PACKAGES = ("sim", "bridge", "deploy")
MODULES = ("numba", "yaml", "pickle")
"""The last is the first that a spawned process imports."""
SCRIPT = Path(sys.executable).with_name("rover-ncp")
COURSE = """
name: moment
start_signal_s: 0.5
horizon_s: 1.0
checkpoints:
- {t: 1.0, x: 0.0, y: 0.0, theta: 0.0}
"""


@pytest.fixture
def folder(tmp_path):
    """A user's folder. What is imported from it ends the process and leaves a file behind."""
    folder = tmp_path / "mine"
    for name in PACKAGES:
        (folder / name).mkdir(parents=True)
    for place in [
        *(folder / name / "__init__.py" for name in PACKAGES),
        *(folder / f"{m}.py" for m in MODULES),
    ]:
        place.write_text(
            f"open({str(tmp_path / 'imported')!r}, 'a').write(__name__ + ' ')\nraise SystemExit(99)\n"
        )
    (folder / "moment.yaml").write_text(COURSE)
    return folder


def run(command, folder):
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    done = subprocess.run(
        [*map(str, command), "--json"],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    imported = folder.parent / "imported"
    assert not imported.exists(), f"imported the user's own {imported.read_text()}: {done.stderr}"
    return done


@pytest.mark.timeout(300)  # processes that start one after the other, on a machine that is busy otherwise
def test_children_import_nothing_from_the_current_folder(folder):
    done = run([SCRIPT, "park", "--policy", "course", "--course", "moment.yaml"], folder)
    assert json.loads(done.stdout)["ticks"] == 10, done.stderr
    quick = ["--agents", "2", "--iterations", "20", "--processes", "2", "--course", "moment.yaml"]
    done = run([SCRIPT, "train", *quick, "--out", "run"], folder)
    assert done.returncode == 0, done.stderr


def test_neither_does_python_m(folder):
    done = run([sys.executable, "-m", "rover_ncp", "course", "check", "moment.yaml"], folder)
    assert done.returncode == 0, done.stderr
