"""An interruption of ``park`` ends all of its processes."""

import json
import signal
import subprocess
import sys

import psutil
import pytest


@pytest.mark.long
def test_ended_process_ends_its_children(tmp_path):
    command = ("park", "--policy", "course")
    child = subprocess.Popen(
        [sys.executable, "-m", "rover_ncp", *command, "--out", str(tmp_path / "out"), "--json"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )
    log = tmp_path / "out" / "log" / "bridge.log"
    while "ready" not in (log.read_text() if log.exists() else ""):
        assert child.poll() is None
    started = psutil.Process(child.pid).children(recursive=True)
    assert len(started) >= 2
    child.send_signal(signal.SIGTERM)
    out, _ = child.communicate(timeout=60)
    assert (child.returncode, json.loads(out)["kind"]) == (130, "Interrupted")
    # With its state: one that ended, but is not waited for yet, would count as running.
    assert [(process.pid, process.status()) for process in started if process.is_running()] == []
