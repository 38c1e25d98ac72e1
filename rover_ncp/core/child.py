"""A command of rover-ncp as a child process that ends with this one; its output goes to a file."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from rover_ncp.core.errors import FileError
from rover_ncp.core.process import PARENT_PIPE, ClosedAtExit

_ERROR = "rover-ncp: "


class ParentPipe(ClosedAtExit):
    """A pipe whose writing end only this process holds: children end when it is closed."""

    def __init__(self) -> None:
        self.reading, self._writing = os.pipe()

    def close(self) -> None:
        """Close both ends: children that still run are interrupted."""
        os.close(self.reading)
        os.close(self._writing)


class Child:
    """A command that runs; it appends all output to its log. Raises FileError if the log cannot be opened."""

    def __init__(self, arguments: Sequence[str], log: Path, pipe: ParentPipe) -> None:
        self.began_s = time.monotonic()
        try:
            with log.open("ab") as output:
                self._log = log.open("rb")
                self._log.seek(0, os.SEEK_END)
                self._process = subprocess.Popen(
                    # -P: the user's folder may hold a sim/ or a scipy.py of its own.
                    [sys.executable, "-P", "-m", "rover_ncp", *arguments],
                    stdin=subprocess.DEVNULL,
                    stdout=output,
                    stderr=output,
                    env=os.environ | {PARENT_PIPE: str(pipe.reading)},
                    pass_fds=[pipe.reading],
                    # A terminal's Ctrl-C or hang-up must reach the parent alone: it ends the bridge first.
                    start_new_session=True,
                )
        except OSError as error:
            raise FileError(f"{log}: cannot be written: {error.strerror}") from error
        self._rest = b""
        self.last_line = ""
        """The newest line of its log."""

    @property
    def pid(self) -> int:
        """The process id."""
        return self._process.pid

    @property
    def code(self) -> int | None:
        """The exit code, negative for a signal; None while it runs."""
        return self._process.poll()

    def new_lines(self) -> list[str]:
        """Return the whole lines that it wrote since the last call, without that of an error, its last."""
        whole, _, self._rest = (self._rest + self._log.read()).rpartition(b"\n")
        lines = [line for line in whole.decode(errors="replace").splitlines() if line.strip()]
        if lines:
            self.last_line = lines[-1].removeprefix(_ERROR)
        return [line for line in lines if not line.startswith(_ERROR)]

    def send(self, number: int) -> None:
        """Send a signal, if it still runs."""
        if self.code is None:
            self._process.send_signal(number)

    def wait(self, timeout_s: float) -> bool:
        """Wait for its end; return whether it ended by itself. After ``timeout_s`` it is killed."""
        try:
            self._process.wait(timeout_s)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
            return False
        return True

    def close(self) -> None:
        """Close its log."""
        self._log.close()

    @property
    def end(self) -> str:
        """How it ended, in words."""
        code = self._process.returncode
        if code < 0:
            return f"killed by {signal.Signals(-code).name}"
        return f"ended with {code}" + (f": {self.last_line}" if self.last_line else "")
