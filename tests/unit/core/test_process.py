"""Termination signals, and the time of suspends."""

import os
import signal
import subprocess
import sys
import time
from itertools import count

import pytest

from rover_ncp.core.process import Interrupts, suspended_s


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_each_is_noted_and_all_is_as_before_afterwards(number):
    before = signal.getsignal(number)
    with Interrupts() as interrupts:
        assert not interrupts.raised
        os.kill(os.getpid(), number)
        os.kill(os.getpid(), number)
        assert (interrupts.raised, interrupts.received) == (True, [number, number])
    assert signal.getsignal(number) is before


def test_ignored_signals_stay_ignored():
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with Interrupts() as interrupts:
            os.kill(os.getpid(), signal.SIGHUP)
            assert not interrupts.raised
        assert signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGHUP, before)


def python(script):
    """Run a script to its end in a process of its own."""
    command = [sys.executable, "-c", script]
    return subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)


DROPPED = """
import ctypes, signal
from rover_ncp.core.process import Interrupts, interrupt_on_signals
interrupt_on_signals()
# ctypes drops what a callback raises, as llvmlite's and pymunk's.
ctypes.CFUNCTYPE(None)(lambda: signal.raise_signal(signal.SIGINT))()
with Interrupts() as interrupts:
    print(interrupts.raised)
"""


def test_signal_that_a_library_drops_before_a_drive_counts_once_the_drive_begins():
    assert python(DROPPED).stdout == "True\n"


FILES = """
import os, resource, sys
from rover_ncp.core.process import require_open_files

resource.setrlimit(resource.RLIMIT_NOFILE, (60, {hard}))
require_open_files(100)
print(len([os.open("/dev/null", os.O_RDONLY) for _ in range(100)]))
"""


def test_limit_of_open_files_is_raised_or_named():
    assert python(FILES.format(hard="resource.getrlimit(resource.RLIMIT_NOFILE)[1]")).stdout == "100\n"
    failed = python(FILES.format(hard=60))
    assert failed.returncode != 0
    assert "this process may open 60 files, expected 1" in failed.stderr


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux counts suspends")
def test_delay_between_the_readings_of_two_clocks_is_no_suspend(monkeypatch):
    late_s, slept_s = count(), {time.CLOCK_BOOTTIME: 5.0, time.CLOCK_MONOTONIC: 0.0}
    monkeypatch.setattr(time, "clock_gettime", lambda clock: next(late_s) + slept_s[clock])
    assert suspended_s() <= 5.0


@pytest.mark.parametrize(
    ("name", "ignored", "code"),
    [("SIGHUP", True, 0), ("SIGHUP", False, 130), ("SIGTERM", True, 130), ("SIGINT", False, 130)],
)
def test_signal_before_a_command_has_installed_its_own_handler_interrupts_it(name, ignored, code):
    script = f"""
import os, signal, sys, time
signal.signal(signal.SIGHUP, signal.SIG_IGN if {ignored} else signal.SIG_DFL)
from rover_ncp import cli
def command(**options):
    os.kill(os.getpid(), signal.{name})
    time.sleep(0.1)
    return 0
cli._app = lambda: command
sys.exit(cli.main())
"""
    done = python(script)
    assert done.returncode == code, done.stderr
    assert "Traceback" not in done.stderr
