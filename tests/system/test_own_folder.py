"""Commands in a folder whose files have the names of our packages and libraries: none of them is imported."""

import json
import os
import subprocess
import sys
import venv
from importlib.metadata import distribution
from pathlib import Path

import pytest
from kit.paths import ROOT

PACKAGES = ("sim", "bridge", "deploy")
MODULES = ("numba", "yaml", "pickle")
"""The last is the first that a spawned process imports."""
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


@pytest.fixture(params=["editable", "wheel"])
def script(request, tmp_path):
    """The rover-ncp of an editable install, or of one as a wheel leaves it behind.

    The latter has links in place of copies, so that its kernels need not be compiled anew.
    """
    if request.param == "editable":
        return Path(sys.executable).with_name("rover-ncp")
    home = tmp_path / "venv"
    venv.create(home, symlinks=True)
    site = next(home.glob("lib/python3*/site-packages"))
    for name in ("rover_ncp", *PACKAGES):
        (site / name).symlink_to(ROOT / name)
    entries = distribution("rover-ncp").read_text("entry_points.txt")
    about = site / "rover_ncp-0.1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.4\nName: rover-ncp\nVersion: 0.1.0\n")
    (about / "entry_points.txt").write_text(entries)
    # Python reads no .pth file of a folder that is named here, such as that of the editable install.
    libraries = [path for path in sys.path if path.endswith("site-packages")]
    (site / "libraries.pth").write_text("\n".join(libraries))
    script = home / "bin" / "rover-ncp"
    script.write_text(
        f'#!{home}/bin/python\nfrom rover_ncp.entry import main\nif __name__ == "__main__":\n    main()\n'
    )
    script.chmod(0o755)
    return script


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
def test_children_import_nothing_from_the_current_folder(script, folder):
    done = run([script, "park", "--policy", "course", "--course", "moment.yaml"], folder)
    assert json.loads(done.stdout)["ticks"] == 10, done.stderr
    quick = ["--agents", "2", "--iterations", "20", "--processes", "2", "--course", "moment.yaml"]
    done = run([script, "train", *quick, "--out", "run"], folder)
    assert done.returncode == 0, done.stderr


def test_neither_does_python_m(folder):
    done = run([sys.executable, "-m", "rover_ncp", "course", "check", "moment.yaml"], folder)
    assert done.returncode == 0, done.stderr
