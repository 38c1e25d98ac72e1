"""A rover-ncp command that hangs or whose wall clock steps back on a signal, with no hook in the command.

Run as ``python hang.py COMMAND ...``. On SIGUSR1 its main thread sleeps for `HANG_S` in C without
releasing the interpreter's lock, as a faulty library would. No other thread of the process runs, and its
sockets stay open. Other processes can detect the hang only by its silence. On a signal of `CLOCK_STEPS_S` the
wall clock that Python reads steps back, as when a computer without a battery-backed clock gets the time.

Python runs a signal's handler when the main thread has the interpreter again, which may be long after the
signal. So the handler itself writes on stderr when the fault begins, as ``applied t_ns=… late_ns=0 hang``.
"""

import ctypes
import os
import signal
import sys
import time

HANG_S = 4
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


def _time_ns() -> int:
    return _true_time_ns() - _clock_behind_ns


if __name__ == "__main__":
    # Before anything imports these names from the module time.
    time.time_ns, time.time = _time_ns, lambda: _time_ns() * 1e-9
    from rover_ncp.entry import main

    signal.signal(signal.SIGUSR1, _hang)
    for each in CLOCK_STEPS_S:
        signal.signal(each, _step_clock)
    main()
