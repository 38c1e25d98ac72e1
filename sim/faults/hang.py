"""A rover-ncp command that hangs when told to, with no hook in the command itself.

Run as ``python -m sim.faults.hang COMMAND ...``. On SIGUSR1 its main thread sleeps for `HANG_S` in C without
letting go of the interpreter, as a library that misbehaves would: no other thread of it runs, and its sockets
stay open. What neither a signal nor a lost connection tells, only silence does.

Python runs a signal's handler when the main thread has the interpreter again, which may be long after the
signal. So the handler itself says on stderr when the hang begins, as ``applied t_ns=… late_ns=0 hang``.
"""

import ctypes
import signal
import sys
import time

from rover_ncp.cli import main

HANG_S = 4


def _hang(*_: object) -> None:
    # PyDLL keeps the interpreter's lock during the call; sleep is cut short by other signals.
    libc = ctypes.PyDLL(None)
    words = f"applied t_ns={time.monotonic_ns()} late_ns=0 hang\n".encode()
    libc.write(sys.stderr.fileno(), words, len(words))
    left = HANG_S
    while left:
        left = libc.sleep(left)


if __name__ == "__main__":
    signal.signal(signal.SIGUSR1, _hang)
    main()
