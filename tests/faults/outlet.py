"""Processes whose output goes to a terminal or a pipe that can be blocked."""

import os
import pty
import select
import threading
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from sim.park.live import Finished, Process

TERMINAL, PIPE, GONE = ("terminal", "pipe", "gone")


class Outlet:
    """The reading end of a process's output: a terminal or a pipe whose reader can stop or go away.

    A process writes to ``fd``. Its output is copied to ``log`` until `block`.
    """

    _XOFF = b"\x13"  # Ctrl-S
    _READ_BYTES, _POLL_S = 4096, 0.05

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
            os.write(self._reader, self._XOFF)
        elif self._kind == GONE:
            os.close(self._reader)
        else:
            # Opened anew: the process's own descriptor must stay one that blocks.
            fd = os.open(f"/proc/self/fd/{self.fd}", os.O_WRONLY | os.O_NONBLOCK)
            with suppress(BlockingIOError):
                while True:
                    os.write(fd, bytes(self._READ_BYTES))
            os.close(fd)

    def close(self) -> None:
        """Close both ends."""
        reader_closed = self._kind == GONE and self._blocked.is_set()
        self._blocked.set()
        self._thread.join()
        os.close(self.fd)
        if not reader_closed:
            os.close(self._reader)

    def _copy(self) -> None:
        with self._log.open("ab", buffering=0) as log:
            while not self._blocked.is_set():
                if select.select([self._reader], [], [], self._POLL_S)[0]:
                    log.write(os.read(self._reader, self._READ_BYTES))


class OutletProcess(Process):
    """A process whose output an `Outlet` of some kind takes."""

    def __init__(
        self, kind: str, command: str, arguments: Sequence[str], log_dir: Path, module: str = "rover_ncp"
    ) -> None:
        self.outlet = Outlet(kind, log_dir / f"{command}.log")
        self._open = True
        super().__init__(command, arguments, log_dir, module, output=self.outlet.fd)

    def stop(self) -> Finished:
        """End it, and close the outlet."""
        try:
            return super().stop()
        finally:
            if self._open:
                self._open = False
                self.outlet.close()
