"""The output of commands, and the options that they share.

With ``--json`` a command prints one JSON object on stdout, and all text for people goes to stderr.

`install` replaces ``sys.stdout`` and ``sys.stderr`` by streams that end in a `Writer`. It delays no caller.
Log lines, rich's displays and tracebacks end there too.
"""

import contextlib
import inspect
import io
import json
import logging
import os
import select
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Annotated, Any, TextIO

import typer
from pydantic_core import to_jsonable_python
from rich.console import Console

from rover_ncp.core.errors import UsageError

if TYPE_CHECKING:
    from pydantic import BaseModel

Json = Annotated[bool, typer.Option("--json", help="Print one JSON object on stdout; text goes to stderr.")]
Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace files that exist already.")]
MAX_SEED = 2**63 - 1
"""Largest seed or trial number."""


def command(run: Callable[[Any], int | None]) -> Callable[..., int | None]:
    """Return a command for typer whose options are the fields of the dataclass that ``run`` takes."""
    (parameter,) = inspect.signature(run, eval_str=True).parameters.values()

    def call(**values: Any) -> int | None:
        return run(parameter.annotation(**values))

    call.__name__, call.__doc__ = run.__name__, run.__doc__
    call.__signature__ = inspect.signature(parameter.annotation, eval_str=True)  # type: ignore[attr-defined]
    return call


def reject(reason: str, **options: Any) -> None:
    """Raise UsageError for options that were given but would have no effect, with the reason.

    None, False and what is empty were not given.
    """
    given = [name for name, value in options.items() if not (value is None or value is False or value == "")]
    if given:
        names = ", ".join(f"--{name.rstrip('_').replace('_', '-')}" for name in given)
        raise UsageError(f"{names}: {reason}")


ROOM_BYTES = 1 << 16
"""Size of a `Writer`'s queue; it drops text beyond."""
CHUNK_BYTES = 1024
"""Size of one system call: a pipe takes it as a whole, a slow terminal within a second."""
_ERRORS = "backslashreplace"
BLOCKED_S = 0.4
"""Time limit at the end of a process for a blocked reader of stdout, and again of stderr."""


class Writer(io.RawIOBase):
    """Write to a copy of a file descriptor from a separate thread; no caller waits or gets an error.

    Text that does not fit into the queue, or that the system rejects, is dropped and counted.
    """

    def __init__(self, fd: int, encoding: str = "utf-8") -> None:
        self._fd, self.encoding = fd, encoding
        try:
            self._own = os.dup(fd)
        except OSError:
            self._own = -1  # closed before the process started: every write fails
        self._changed = threading.Condition()
        self._waiting: deque[bytes] = deque()
        self._bytes = self._dropped = self._chunks = 0
        self.failure: OSError | None = None
        """Error of the last write, if it failed."""
        threading.Thread(target=self._run, name=f"output-{fd}", daemon=True).start()

    def put(self, data: bytes, keep: bool = False) -> None:
        """Queue data; ``keep`` queues it even when there is no room."""
        with self._changed:
            if self._bytes >= ROOM_BYTES and not keep:
                self._dropped += 1
                return
            if self._dropped:
                self._append(f"rover-ncp: lines of output dropped here: {self._dropped}\n".encode())
                self._dropped = 0
            self._append(data)
            self._changed.notify_all()

    def drained(self, blocked_s: float | None) -> bool:
        """Wait until all is written, or the reader takes nothing for ``blocked_s``; return whether all is."""
        with self._changed:
            chunks, since_s = self._chunks, time.monotonic()
            while self._waiting:
                left_s = None if blocked_s is None else since_s + blocked_s - time.monotonic()
                if left_s is not None and left_s <= 0.0:
                    return False
                self._changed.wait(left_s)
                if self._chunks != chunks:
                    chunks, since_s = self._chunks, time.monotonic()
            return self.failure is None

    def write(self, data: Any) -> int:
        """Queue data, as a file."""
        self.put(bytes(data))
        return len(data)

    def writable(self) -> bool:
        """Return True."""
        return True

    def isatty(self) -> bool:
        """Return whether this is a terminal."""
        return self._own >= 0 and os.isatty(self._own)

    def fileno(self) -> int:
        """Return the original descriptor, for child processes."""
        return self._fd

    def _append(self, data: bytes) -> None:
        self._waiting.append(data)
        self._bytes += len(data)

    def _run(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._waiting)
                data = self._waiting[0]
            try:
                self._write_out(data)
                failure = None
            except OSError as error:
                failure = error
            with self._changed:
                self.failure = failure
                self._dropped += failure is not None
                self._waiting.popleft()
                self._bytes -= len(data)
                self._changed.notify_all()

    def _write_out(self, data: bytes) -> None:
        left = memoryview(data)
        while left:
            try:
                left = left[os.write(self._own, left[:CHUNK_BYTES]) :]
                self._chunks += 1
            except BlockingIOError:  # another process made the shared descriptor non-blocking
                select.select([], [self._own], [])


def install() -> tuple[Writer, Writer]:
    """Replace ``sys.stdout`` and ``sys.stderr`` by streams that never block; return their writers.

    A character that the locale's encoding lacks is written as its escape sequence.
    """
    writers = tuple(
        Writer(fd, getattr(stream, "encoding", "utf-8")) for fd, stream in ((1, sys.stdout), (2, sys.stderr))
    )
    sys.stdout, sys.stderr = (
        io.TextIOWrapper(
            writer,  # type: ignore[type-var]  # Python's own unbuffered stdout has a raw layer here, too
            encoding=writer.encoding,
            errors=_ERRORS,
            write_through=True,
        )
        for writer in writers
    )
    return writers[0], writers[1]


def keep(stream: TextIO, text: str) -> None:
    """Write text that must not be dropped while the reader takes data."""
    writer = getattr(stream, "buffer", None)
    if isinstance(
        writer, Writer
    ):  # also behind the stream that rich puts in place of ours: it has no encoding
        writer.put(text.encode(writer.encoding, _ERRORS), keep=True)
    else:
        stream.write(text)
        stream.flush()


def printable(text: str) -> str:
    """Return text with control characters as escape sequences: network text must not forge a line of ours."""
    if text.isprintable():
        return text
    return "".join(char if char.isprintable() else char.encode("unicode_escape").decode() for char in text)


class Output(logging.Handler):
    """The two channels of a command. ``controls`` means that a rover depends on this process: it logs."""

    ended = False
    """Whether a command of this process has printed its result; it must not get a second one."""
    blocked_s: float | None = None
    """Wait in s at the end of this process for a reader that takes nothing; None is without limit."""

    def __init__(self, as_json: bool, *, controls: bool = False) -> None:
        super().__init__()
        self.as_json = as_json
        self.console = Console(stderr=as_json, highlight=False, soft_wrap=True)
        if controls:
            Output.blocked_s = BLOCKED_S
            logger = logging.getLogger("rover_ncp")
            logger.setLevel(logging.INFO)
            logger.handlers = [self]

    def emit(self, record: logging.LogRecord) -> None:
        """Print a line of the log."""
        self.say(record.getMessage())

    def say(self, text: str) -> None:
        """Print a line for people, unless it is empty; it is dropped when they read too slowly."""
        if text:
            self.console.print(printable(text), markup=False, emoji=False)

    def announce(self, text: str) -> None:
        """Print a line that programs wait for; it is never dropped while they read."""
        keep(sys.stderr if self.as_json else sys.stdout, printable(text) + "\n")

    @contextlib.contextmanager
    def live(self, line: Callable[[], str]) -> Iterator[None]:
        """Show a changing line, on a terminal only; a thread draws it, so no terminal delays the caller."""
        if not self.console.is_terminal:
            yield
            return
        from rich.live import Live

        with Live(
            get_renderable=line,
            console=self.console,
            refresh_per_second=5,
            transient=True,
            redirect_stdout=False,
            redirect_stderr=False,
        ):
            yield

    def result(self, result: "BaseModel", text: str) -> None:
        """End a command: its result as JSON, or the text. A number that is not finite becomes null."""
        Output.ended = True
        if self.as_json:
            # numpy's numbers and arrays have tolist.
            plain = to_jsonable_python(
                result.model_dump(by_alias=True), inf_nan_mode="null", fallback=lambda value: value.tolist()
            )
            keep(sys.stdout, json.dumps(plain, allow_nan=False) + "\n")
        else:
            for line in text.split("\n"):
                self.announce(line)
