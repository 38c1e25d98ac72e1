"""A rover-ncp command with faults that signals cause, and no hook in the command for them.

Run as ``python hang.py COMMAND ...``. On SIGUSR1 its main thread sleeps for `HANG_S` in C without
releasing the interpreter's lock, as a faulty library would. No other thread of the process runs, and its
sockets stay open. Other processes can detect the hang only by its silence. On a signal of `CLOCK_STEPS_S` the
wall clock that Python reads steps back, as when a computer without a battery-backed clock gets the time. On
`SILENT_CLOSE` the ``close`` of a bridge's base sends nothing from then on, as in a careless base driver.

Python runs a signal's handler when the main thread has the interpreter again, which may be long after the
signal. So the handler itself writes on stderr when the fault begins, as ``applied t_ns=… late_ns=0 hang``.
"""

import ctypes
import os
import signal
import sys
import time

HANG_S = 4
SILENT_CLOSE = int(signal.SIGRTMIN) + 3
CLOCK_STEPS_S = {int(signal.SIGRTMIN) + number: step_s for number, step_s in enumerate((0.3, 0.6, 3600.0))}

_clock_behind_ns = 0
_true_time_ns = time.time_ns


def _applied(fault: str) -> bytes:
    return f"applied t_ns={time.monotonic_ns()} late_ns=0 {fault}\n".encode()


def _hang(*_: object) -> None:
    # PyDLL keeps the interpreter's lock during the call; sleep is cut short by other signals.
    libc = ctypes.PyDLL(None)
    words = _applied("hang")
    libc.write(sys.stderr.fileno(), words, len(words))
    left = HANG_S
    while left:
        left = libc.sleep(left)


def _step_clock(number: int, _: object) -> None:
    global _clock_behind_ns  # noqa: PLW0603  # a clock is global
    _clock_behind_ns += round(CLOCK_STEPS_S[number] * 1e9)
    os.write(sys.stderr.fileno(), _applied("clock"))


def _silence_close(*_: object) -> None:
    from bridge.pioneer.base import ArcosBase
    from bridge.ros2.base import Ros2Base

    for base in (ArcosBase, Ros2Base):
        base.close = lambda self, now: None
    os.write(sys.stderr.fileno(), _applied("close"))


def _time_ns() -> int:
    return _true_time_ns() - _clock_behind_ns


if __name__ == "__main__":
    # Before anything imports these names from the module time.
    time.time_ns, time.time = _time_ns, lambda: _time_ns() * 1e-9
    from rover_ncp.cli import main

    signal.signal(signal.SIGUSR1, _hang)
    signal.signal(SILENT_CLOSE, _silence_close)
    for each in CLOCK_STEPS_S:
        signal.signal(each, _step_clock)
    sys.exit(main())
