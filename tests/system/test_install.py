"""The wheel, installed into fresh environments: all that a user needs comes with it."""

import json
import os
import re
import shutil
import subprocess
import sys

import pytest
from kit.paths import ROOT

COLD = pytest.mark.timeout(600)  # downloads
# What each set of extras makes possible, as command lines and their exit codes.
WORKS = {
    "": [("--version", 0), ("bridge --base tcp/127.0.0.1:1", 3)],
    "drive": [
        ("course check parking --out parking.png", 0),
        ("export parking --to c --out exported", 0),
        ("keys --out keys", 0),
        ("watch --robot tcp/127.0.0.1:1", 3),
    ],
    "train": [
        ("eval parking", 0),
        ("park --policy nowhere.yaml", 2),
        # These start processes, which must not import a user's modules either.
        ("park --policy course --course moment.yaml --out park", 1),
        ("train --agents 2 --iterations 20 --processes 2 --course moment.yaml --out run", 0),
    ],
    "tag": [("tag print --ids 0 --size 0.14 --out tags.pdf", 0)],
    "research": [
        ("train --cluster tcp://127.0.0.1:1 --agents 1 --iterations 1 --out run", 2),
        ("eval course --stack --body mujoco --randomize nominal", 0),
    ],
}
COURSE = """
name: moment
start_signal_s: 0.5
horizon_s: 1.0
checkpoints:
- {t: 1.0, x: 0.0, y: 0.0, theta: 0.0}
"""
# A command that needs other extras, and those.
MISSING = {
    "": ("park --dock", "tag,train"),
    "drive": ("mock", "train"),
    "train": ("eval course --stack --body=mujoco", "research"),
}


def run(command, folder, code=0, **variables):
    environment = os.environ | variables
    done = subprocess.run(
        command, cwd=folder, env=environment, capture_output=True, text=True, timeout=280, check=False
    )
    assert done.returncode == code, (command, done.stdout[-2000:], done.stderr[-2000:])
    return done


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    """The wheel that is built from the sdist."""
    folder = tmp_path_factory.mktemp("built")
    run([sys.executable, "-m", "build", "--outdir", str(folder), str(ROOT)], folder)
    (wheel,) = folder.glob("*.whl")
    return wheel


@COLD
@pytest.mark.parametrize("extras", WORKS)
def test_an_installed_wheel_does_what_its_extras_promise(extras, wheel, tmp_path):
    check_install(extras, wheel, tmp_path)


def install(archive, extras, folder):
    """Install into a fresh environment and return its programs."""
    # Without a pip of its own, and without compiling modules that no command loads: half of the time.
    run([sys.executable, "-m", "venv", "--without-pip", "env"], folder)
    programs = folder / "env" / "bin"
    asked = f"{archive}[{extras}]" if extras else str(archive)
    pip = [sys.executable, "-m", "pip", "--python", str(programs / "python"), "install", "--quiet"]
    run([*pip, "--no-compile", "--constraint", str(ROOT / "constraints.txt"), asked], folder)
    return programs


def check_install(extras, archive, folder):
    """Install into a fresh environment, and run commands there that must work or name what is missing."""
    programs = install(archive, extras, folder)
    # A user's own, which must not be imported; a spawned process imports pickle first.
    (folder / "moment.yaml").write_text(COURSE)
    for name in ("sim", "bridge", "deploy"):
        (folder / name).mkdir()
    for name in ("sim/__init__", "bridge/__init__", "deploy/__init__", "scipy", "yaml", "pickle"):
        (folder / f"{name}.py").write_text("open('imported', 'a').write(__name__)\nraise SystemExit(99)\n")
    command = str(programs / "rover-ncp")
    assert run([command, "--version"], folder).stdout.startswith("rover-ncp ")
    run([command, "--help"], folder)
    for line, code in WORKS[extras]:
        run([command, *line.split()], folder, code)
    run([str(programs / "python"), "-m", "rover_ncp", "--help"], folder)
    assert not (folder / "imported").exists()
    assert (folder / "park" / "run.html").is_file() == (extras == "train")
    if extras in MISSING:
        line, needed = MISSING[extras]
        error = json.loads(run([command, *line.split(), "--json"], folder, 2).stdout)
        assert error["kind"] == "MissingExtra"
        # Both ways as they are printed, of the wheel that was installed.
        requirement = f"rover-ncp[{needed}] @ {archive.as_uri()}"
        assert f"pip install '{requirement}'. " in error["error"]
        assert error["error"].endswith(f"uvx --from '{requirement}' rover-ncp {line} --json")


@COLD
def test_without_a_compiler_a_robot_drives_and_only_training_needs_the_library(tmp_path):
    # From what the build stage of the image has.
    stage = (ROOT / "packaging" / "Dockerfile").read_text().split("RUN")[0]
    source = tmp_path / "source"
    for line in re.findall("^COPY (.*) /source/", stage, re.MULTILINE):
        for name in line.split():
            assert f"!{name}" in (ROOT / ".dockerignore").read_text().split()
            source.mkdir(exist_ok=True)
            copy = shutil.copytree if (ROOT / name).is_dir() else shutil.copy
            copy(ROOT / name, source / name)
    wheel = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", str(source)]
    run(wheel, tmp_path, ROVER_NCP_PURE="1", PATH="")
    (archive,) = tmp_path.glob("*-py3-none-any.whl")
    command = str(install(archive, "train", tmp_path) / "rover-ncp")
    for line in ("eval parking", "park --policy parking --out park", "replay park/run.mcap"):
        shown = run([command, *line.split()], tmp_path).stderr
        assert shown.count("warning: ") == ("park" not in line.split())  # there the driver's log has it
    training = "train --agents 1 --iterations 20 --out run"
    (line,) = run([command, *training.split()], tmp_path, 2).stderr.splitlines()
    assert "needs the native library" in line
    # The library gives the same commands, to the last bit.
    run([sys.executable, "-m", "rover_ncp", "replay", "park/run.mcap"], tmp_path)
