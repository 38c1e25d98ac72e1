"""Recordings in a viewer that is not ours; `make test-browser` installs what this needs."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from kit.paths import DATA

from rover_ncp import cli
from rover_ncp.recording.recording import read_recording

pytestmark = pytest.mark.browser

COURSE = DATA / "short_course.yaml"
QUIET = os.environ | {"RERUN_ANALYTICS": "0", "NO_COLOR": "1"}
HOW = {"env": QUIET, "timeout": 60, "capture_output": True, "text": True}


def rerun():
    """Return the path of the viewer's command."""
    found = shutil.which(
        "rerun", path=os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    )
    assert found, "no rerun: make test-browser installs it"
    return found


def checked(recording):
    """Return topic → status as `rerun mcap check` prints them; it must find the file sound."""
    done = subprocess.run([rerun(), "mcap", "check", str(recording)], check=False, **HOW)
    assert done.returncode == 0, done.stdout + done.stderr
    rows = [line.split() for line in done.stdout.splitlines()]
    return {row[3]: (row[0], row[4]) for row in rows if len(row) == 5 and row[1].isdigit()}


def test_a_live_drive_opens_without_complaint(tmp_path, capsys):
    status = cli.run(
        ["park", "--policy", "parking", "--course", str(COURSE), "--out", str(tmp_path / "park")]
    )
    assert status in {0, 1}, capsys.readouterr().err  # that course is short, not made to be parked on
    recording = tmp_path / "park" / "run.mcap"
    told = checked(recording)
    assert set(told) == {message.topic for message in read_recording(recording).messages}
    assert {"odom", "tf", "tf_static", "deploy/path", "neurons/AVB", "rover/estimate", "truth/pose"} <= set(
        told
    )
    assert set(told.values()) == {("ok", "—")}
