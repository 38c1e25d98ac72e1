"""A rover-ncp command that hangs when told to, with no hook in the command itself.

Run as ``python -m sim.studies.hang COMMAND ...``. On SIGUSR1 its main thread sleeps for `HANG_S` in C without
letting go of the interpreter, as a library that misbehaves would: no other thread of it runs, and its sockets
stay open. What neither a signal nor a lost connection tells, only silence does.
"""

import ctypes
import signal

from rover_ncp.shell import main

__all__ = ["HANG_S"]

HANG_S = 4


def _hang(*_: object) -> None:
    # PyDLL keeps the interpreter's lock during the call; sleep is cut short by other signals.
    left = HANG_S
    while left:
        left = ctypes.PyDLL(None).sleep(left)


if __name__ == "__main__":
    signal.signal(signal.SIGUSR1, _hang)
    main()
