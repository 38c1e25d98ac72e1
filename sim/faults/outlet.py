"""The far end of a process's output: a terminal or a pipe, until its reader stops or goes away."""

import os
import pty
import select
import threading
from contextlib import suppress
from pathlib import Path

TERMINAL, PIPE, GONE = "terminal", "pipe", "gone"
OUTLETS = (TERMINAL, PIPE, GONE)
XOFF = b"\x13"
"""Ctrl-S."""
READ_BYTES, POLL_S = 4096, 0.05


class Outlet:
    """A process writes to ``fd``. Its output is copied to ``log`` until `block`."""

    def __init__(self, kind: str, log: Path) -> None:
        self._kind, self._log = kind, log
        self._reader, self.fd = pty.openpty() if kind == TERMINAL else os.pipe()
        self._blocked = threading.Event()
        self._thread = threading.Thread(target=self._copy, name="outlet", daemon=True)
        self._thread.start()

    def block(self) -> None:
        """Stop the terminal, fill the pipe, or close the reader's end; the second time, do nothing."""
        if self._blocked.is_set():
            return
        self._blocked.set()
        self._thread.join()
        if self._kind == TERMINAL:
            os.write(self._reader, XOFF)
        elif self._kind == GONE:
            os.close(self._reader)
        else:
            # Opened anew: the process's own descriptor must stay one that blocks.
            fd = os.open(f"/proc/self/fd/{self.fd}", os.O_WRONLY | os.O_NONBLOCK)
            with suppress(BlockingIOError):
                while True:
                    os.write(fd, bytes(READ_BYTES))
            os.close(fd)

    def close(self) -> None:
        """Close both ends."""
        gone = self._kind == GONE and self._blocked.is_set()
        self._blocked.set()
        self._thread.join()
        os.close(self.fd)
        if not gone:
            os.close(self._reader)

    def _copy(self) -> None:
        with self._log.open("ab", buffering=0) as log:
            while not self._blocked.is_set():
                if select.select([self._reader], [], [], POLL_S)[0]:
                    log.write(os.read(self._reader, READ_BYTES))
