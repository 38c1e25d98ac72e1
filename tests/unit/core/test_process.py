"""Termination signals, and the time of suspends."""

import os
import signal
import subprocess
import sys

import pytest

from rover_ncp.core.process import Interrupts


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_each_is_noted_and_all_is_as_before_afterwards(number):
    before = signal.getsignal(number)
    with Interrupts() as interrupts:
        assert not interrupts.raised
        os.kill(os.getpid(), number)
        os.kill(os.getpid(), number)
        assert (interrupts.raised, interrupts.received) == (True, [number, number])
    assert signal.getsignal(number) is before


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
