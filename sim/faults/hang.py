"""A rover-ncp command that hangs on a signal, with no hook in the command itself.

Run as ``python -m sim.faults.hang COMMAND ...``. On SIGUSR1 its main thread sleeps for `HANG_S` in C without
releasing the interpreter's lock, as a faulty library would. No other thread of the process runs, and its
sockets stay open. Other processes can detect the hang only by its silence.

Python runs a signal's handler when the main thread has the interpreter again, which may be long after the
signal. So the handler itself writes on stderr when the hang begins, as ``applied t_ns=… late_ns=0 hang``.
"""

import ctypes
import signal
import sys
import time

from rover_ncp.entry import main

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
