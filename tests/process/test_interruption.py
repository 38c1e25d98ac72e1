"""Signals at any moment of a command, from its first line on: exit code 130 and one line."""

import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from kit.paths import ROOT

from rover_ncp.core.interruption import SIGNALS

SCRIPT = Path(sys.executable).with_name("rover-ncp")
STEP_S, END_S = float(os.environ.get("ROVER_NCP_SIGNAL_STEP_S", "0.2")), 3.0
COMMANDS = {
    "--help": 0,
    "check --on-blocks --robot tcp/127.0.0.1:1": 3,
    "course check parking": 0,
    "bridge --base tcp/127.0.0.1:1 --listen tcp/127.0.0.1:0": 3,
    "deploy --robot tcp/127.0.0.1:1": 3,
    "eval parking --trials 2000 --randomize full": 0,
    "mock --listen 127.0.0.1:0": 0,
    "report missing.mcap": 2,
    "train --agents 2 --iterations 100000": 0,
}
"""Commands, and their exit codes where nothing interrupts them; the mock's is the same then."""

# Sends itself a signal when a module is imported for the first time, before Python looks for its file.
AT_IMPORT = """
import os, sys
from importlib.abc import MetaPathFinder

module, number = sys.argv[1:3]

class Interrupting(MetaPathFinder):
    def find_spec(self, name, path, target=None):
        if name == module:
            os.kill(os.getpid(), int(number))

sys.meta_path.insert(0, Interrupting())
from rover_ncp.entry import main
sys.argv[1:] = sys.argv[3:]
main()
"""


def python(script, *arguments):
    command = [sys.executable, "-c", script, *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, cwd=ROOT, check=False)


@pytest.mark.parametrize(
    ("module", "number", "command"),
    [
        *(
            (module, number, "course check parking")
            for module, number in zip(["typer", "rich", "rover_ncp.core.console"], SIGNALS, strict=True)
        ),
        ("numpy", signal.SIGINT, "course check parking"),
        ("scipy.linalg", signal.SIGINT, "course check parking"),
        ("numba.core.types", signal.SIGINT, "eval parking"),
        pytest.param("pymunk", signal.SIGINT, "eval parking", marks=pytest.mark.long),
    ],
)
def test_signal_while_modules_are_imported_is_an_interruption(module, number, command):
    done = python(AT_IMPORT, module, int(number), *command.split(), "--json")
    assert (done.returncode, done.stderr) == (130, "rover-ncp: interrupted\n")
    assert json.loads(done.stdout)["exit_code"] == 130


# A condition gives up its lock before it waits. Interrupted there, it gives it up again: another error.
AT_WAIT = """
import os, sys, threading
from rover_ncp.entry import main

release, left = threading.Condition._release_save, [int(sys.argv[1])]

def interrupting(self):
    state = release(self)
    if threading.current_thread() is threading.main_thread():
        left[0] -= 1
        if left[0] == 0:
            os.kill(os.getpid(), 2)
    return state

threading.Condition._release_save = interrupting
sys.argv[1:] = sys.argv[2:]
main()
"""


@pytest.mark.parametrize("number", [1, 2])
def test_signal_while_a_lock_is_waited_for_is_an_interruption(number):
    """The first two waits are for the start of the threads that write output."""
    done = python(AT_WAIT, number, "course", "check", "parking", "--json")
    assert (done.returncode, done.stderr) == (130, "rover-ncp: interrupted\n")


DROPPED = """
import sys, time
from rover_ncp.core import interruption
class Dropping:
    def __del__(self):
        interruption.signal.raise_signal(interruption.signal.SIGINT)
interruption.handle_signals()
try:
    Dropping()
    time.sleep(20)
except KeyboardInterrupt:
    print("interrupted")
"""


def test_interruption_that_python_drops_is_raised_again():
    done = python(DROPPED)
    assert (done.returncode, done.stdout, done.stderr) == (0, "interrupted\n", "")


PROGRESS = """
import sys
from rich.console import Console
from rich.progress import Progress
from rover_ncp.core.console import install, keep
stdout, stderr = install()
with Progress(console=Console(stderr=True, force_terminal=True)):
    keep(sys.stderr, "rover-ncp: interrupted\\n")
stderr.drained(None)
"""


def test_last_line_is_written_while_rich_shows_progress():
    done = python(PROGRESS)
    assert done.returncode == 0
    assert "rover-ncp: interrupted\n" in done.stderr


@pytest.mark.long
@pytest.mark.timeout(1800)
@pytest.mark.parametrize(("command", "result"), COMMANDS.items())
def test_ctrl_c_at_any_moment_is_exit_code_130_without_a_traceback(command, result, tmp_path):
    after_s = 0.0
    while (after_s := after_s + STEP_S) < END_S:
        process = subprocess.Popen(
            [SCRIPT, *command.split()],
            cwd=tmp_path,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )
        _wait_for_handlers(process)
        time.sleep(after_s)
        ended_before = process.poll()
        process.send_signal(signal.SIGINT)
        try:
            _, printed = process.communicate(timeout=60)
        finally:
            process.kill()
        assert not re.search("Traceback|ignored", printed), f"after {after_s:.2f} s: {printed}"
        if ended_before is not None:
            return
        # The signal can come after the result.
        assert process.returncode in {130, result}, f"after {after_s:.2f} s: {printed}"


def _wait_for_handlers(process):
    """Wait until the script handles SIGTERM; before that, the interpreter itself starts."""
    while process.poll() is None:
        caught = re.search(r"SigCgt:\s*(\w+)", Path(f"/proc/{process.pid}/status").read_text())[1]
        if int(caught, 16) & 1 << (signal.SIGTERM - 1):
            return
        time.sleep(0.001)
