"""The train command as real processes: any number of them, interrupted and killed."""

import json
import os
import random
import signal
import subprocess
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from kit.paths import DATA, content
from kit.training_processes import is_running, start_rover_ncp

from rover_ncp.circuit.policy_file import load_policy
from rover_ncp.cli import run
from sim.park.live import wait_for

pytestmark = pytest.mark.usefixtures("no_git")

TRAIN = ["train", "--course", str(DATA / "short_course.yaml"), "--agents", "2", "--seed", "11"]


def children(pid):
    try:
        return [int(child) for child in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]
    except FileNotFoundError:
        return []


def test_ctrl_c_ends_cleanly_with_130_and_a_state_to_resume(tmp_path):
    """Ctrl-C reaches the whole process group, as from a terminal."""
    out = tmp_path / "run"
    options = ["--agents", "300", "--iterations", "300", "--out", str(out), "--processes", "2", "--json"]
    process = start_rover_ncp(*TRAIN, *options, output=subprocess.PIPE)
    try:
        wait_for((out / "policy.yaml").exists, 60.0)
        workers = children(process.pid)
        os.killpg(process.pid, signal.SIGINT)
        printed, errors = process.communicate(timeout=30)
    finally:
        process.kill()
        process.communicate()  # or a later test would get the warnings about what is left open
    assert process.returncode == 130
    assert json.loads(printed)["exit_code"] == 130
    assert errors.endswith(f"Go on with: rover-ncp train --out {out} --resume\nrover-ncp: interrupted\n")
    assert "Traceback" not in errors
    wait_for(lambda: not any(is_running(pid) for pid in workers), 10)
    assert load_policy(out / "policy.yaml")
    assert not list(out.rglob(".*"))


# Files of a run: while the workers start, at work, and at the end.
MOMENTS = ["settings.yaml", "agents/00.json", "policy.yaml", "agents/01.yaml", "curve.png"]


@pytest.mark.long
def test_killed_again_and_again_it_ends_in_the_same_bytes(tmp_path):
    """Each kill comes up to 0.1 s after another moment, and the run goes on from there."""
    train = [*TRAIN, "--iterations", "500"]
    assert run([*train, "--out", str(tmp_path / "undisturbed"), "--processes", "1"]) == 0
    expected = content(tmp_path / "undisturbed")
    assert len(expected) == 4 + 2 * 2
    assert set(MOMENTS) <= set(expected)

    def kill_again_and_again(processes, moments):
        out = tmp_path / processes

        def command():
            going_on = ["--resume"] if (out / "settings.yaml").exists() else []
            return [*train, "--out", str(out), "--processes", processes, *going_on]

        chance = random.Random(processes)
        for moment in moments:
            process = start_rover_ncp(*command(), output=subprocess.PIPE)
            wait_for(lambda at=moment, child=process: (out / at).exists() or child.poll() is not None, 60.0)
            time.sleep(chance.uniform(0.0, 0.1))
            workers = children(process.pid)
            process.kill()
            wait_for(lambda pids=workers: not any(is_running(pid) for pid in pids), 30)
            process.communicate()
        last = start_rover_ncp(*command(), output=subprocess.PIPE)
        _, errors = last.communicate(timeout=100)
        assert last.returncode == 0, errors
        return content(out)

    with ThreadPoolExecutor(2) as pool:
        for end in pool.map(kill_again_and_again, ["1", "2"], [MOMENTS, MOMENTS[::2]]):
            assert end == expected
