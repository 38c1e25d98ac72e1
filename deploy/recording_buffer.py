"""Recording and status line of a driving process."""

import contextlib
from collections import deque
from collections.abc import Callable, Iterator
from pathlib import Path

from rich.live import Live

from deploy.recorder import Recorder
from rover_ncp.core.console import Output
from rover_ncp.core.files import require_creatable
from rover_ncp.core.recording import Recorded

BACKLOG = 1000
"""Messages that came before the recording was opened, such as the static transforms."""


class Tape:
    """Buffer of messages to record: kept until there is a recorder, discarded without one."""

    def __init__(self, path: Path | None, *, overwrite: bool = False) -> None:
        """Raise FileError if a recording could not be made at ``path``; None makes none."""
        if path is not None:
            require_creatable(path, overwrite=overwrite)
        self._path, self._overwrite = path, overwrite
        self._backlog: deque[Recorded] = deque(maxlen=BACKLOG)
        self.recorder: Recorder | None = None

    def put(self, message: Recorded) -> None:
        """Take a message, from any thread."""
        if self.recorder is None:
            self._backlog.append(message)
        else:
            self.recorder.put(message)

    def roll(self, files: dict[str, bytes]) -> None:
        """Open the recording, if there is to be one. Raises FileError."""
        if self._path is None:
            return
        recorder = Recorder(self._path, files, overwrite=self._overwrite)
        for message in list(self._backlog):
            recorder.put(message)
        self.recorder = recorder

    def close(self) -> None:
        """Finish the recording, if there is one."""
        if self.recorder is not None:
            self.recorder.close()


@contextlib.contextmanager
def progress(line: Callable[[], str], output: Output) -> Iterator[None]:
    """Show a line that changes, on a terminal only; drawn by a thread, so that no terminal delays a tick."""
    if not output.console.is_terminal:
        yield
        return

    with Live(
        get_renderable=line,
        console=output.console,
        refresh_per_second=5,
        transient=True,
        redirect_stdout=False,
        redirect_stderr=False,
    ):
        yield
