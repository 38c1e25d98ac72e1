"""The picture of a localiser that is written to a file."""

import queue
import threading
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Self

from deploy.tag.view import View
from rover_ncp.core.errors import FileError
from rover_ncp.core.files import write_atomic

FILE_END_S = 2.0
"""Time that a disk gets for the last picture of a file."""


class ViewFile:
    """Writes views to one file, in a thread of its own: no pose waits for a disk, or ends with a full one.

    A context manager. One view waits while another is being written, and further ones are left out. ``say``
    gets a line when writing begins to fail.
    """

    def __init__(self, path: Path, say: Callable[[str], None]) -> None:
        self._path, self._say = path, say
        self._views = queue.Queue[View | None](maxsize=1)
        self._thread = threading.Thread(target=self._run, name="view", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with suppress(queue.Full):  # else the disk hangs
            self._views.put(None, timeout=FILE_END_S)
        self._thread.join(FILE_END_S)

    def show(self, view: View) -> None:
        """Write a view, unless another one waits."""
        with suppress(queue.Full):
            self._views.put_nowait(view)

    def _run(self) -> None:
        fails = False
        while (view := self._views.get()) is not None:
            try:
                write_atomic(self._path, view.jpeg())
                fails = False
            except FileError as error:
                if not fails:
                    self._say(f"no picture for people: {error}")
                fails = True
