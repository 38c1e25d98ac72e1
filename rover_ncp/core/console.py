"""The output of commands, and the options that they share.

With ``--json`` a command prints one JSON object on stdout, and all text for people goes to stderr. Where a
rover depends on the process, a thread writes all text, so that no output delays the command.
"""

import contextlib
import inspect
import json
import logging
import math
import os
import queue
import shutil
import sys
import threading
import time
from collections.abc import Callable, Iterator
from logging.handlers import QueueHandler, QueueListener
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, TextIO

import typer
from pydantic_core import to_jsonable_python

from rover_ncp.core.errors import FileError, UsageError

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


MAX_LINES = 1000
"""Lines that wait for the thread; more are dropped and counted."""
BLOCKED_S = 0.4
"""Time limit at the end of a process for a reader that takes nothing."""
_REDRAW_S = 0.2
_ERASE = "\r\x1b[2K"


def printable(text: str) -> str:
    """Return text with control characters as escape sequences: network text must not forge a line of ours."""
    if text.isprintable():
        return text
    return "".join(char if char.isprintable() else char.encode("unicode_escape").decode() for char in text)


class _Lines(QueueHandler):
    """Queues lines for a thread that writes them. A full queue drops lines, and no caller waits."""

    queue: queue.Queue[logging.LogRecord]

    def __init__(self, stream: TextIO) -> None:
        super().__init__(queue.Queue(MAX_LINES))
        self.dropped = 0
        self.failure: OSError | None = None
        """Error of the last write to stdout, if it failed."""
        self._stream, self._drawn = stream, False
        self._began_s = math.inf
        """When the present write began."""
        writer = logging.Handler()
        writer.emit = self._write  # type: ignore[method-assign]
        QueueListener(self.queue, writer).start()

    def put(self, stream: TextIO, text: str, *, drawn: bool = False) -> None:
        """Queue a line, or with ``drawn`` one that the next line replaces."""
        self.enqueue(logging.makeLogRecord({"msg": text, "stream": stream, "drawn": drawn}))

    def enqueue(self, record: logging.LogRecord) -> None:
        """Queue a record of the log."""
        try:
            self.queue.put_nowait(record)
        except queue.Full:
            self.dropped += 1

    def drained(self) -> bool:
        """Wait until all is written, or the reader takes nothing for `BLOCKED_S`; return whether all is."""
        while self.queue.unfinished_tasks:
            if time.monotonic() - self._began_s > BLOCKED_S:
                return False
            time.sleep(0.001)
        return True

    def _write(self, record: logging.LogRecord) -> None:
        drawn, stream = getattr(record, "drawn", False), getattr(record, "stream", self._stream)
        text = printable(record.getMessage())
        if not drawn:
            text += "\n"
            if self.dropped:
                text = f"rover-ncp: lines of output dropped here: {self.dropped}\n{text}"
                self.dropped = 0
        if self._drawn or drawn:
            text = _ERASE + text
        self._drawn = drawn
        failure, self._began_s = None, time.monotonic()
        try:
            stream.write(text)
            stream.flush()
        except OSError as error:
            failure = error
        self._began_s = math.inf
        if stream is not sys.stderr:
            self.failure = failure


class Output(logging.Handler):
    """The two channels of a command. ``controls`` means that a rover depends on this process: it logs."""

    ended: ClassVar[bool] = False
    """Whether a command of this process has printed its result; it must not get a second one."""
    lines: ClassVar[_Lines | None] = None
    """The queue of the command that runs, if a rover depends on it."""
    blocked: ClassVar[bool] = False
    """Whether the last command has left output that its reader does not take."""

    def __init__(self, as_json: bool, *, controls: bool = False) -> None:
        super().__init__()
        self.as_json = as_json
        if controls:
            Output.lines = _Lines(self._people)
            logger = logging.getLogger("rover_ncp")
            logger.setLevel(logging.INFO)
            logger.handlers = [Output.lines]
            logging.lastResort = Output.lines  # of libraries: Python's own writes to stderr itself

    @property
    def _people(self) -> TextIO:
        """The stream of text for people."""
        return sys.stderr if self.as_json else sys.stdout

    def say(self, text: str) -> None:
        """Print a line for people, unless it is empty."""
        if text:
            print_line(self._people, text)

    def announce(self, text: str) -> None:
        """Print a line that programs wait for."""
        print_line(self._people, text)

    @contextlib.contextmanager
    def live(self, line: Callable[[], str]) -> Iterator[None]:
        """Show a changing line, on a terminal only."""
        stream, lines, ended = self._people, Output.lines, threading.Event()
        if lines is None or not stream.isatty():
            yield
            return

        def draw() -> None:
            while not ended.wait(_REDRAW_S):
                lines.put(stream, line()[: shutil.get_terminal_size().columns - 1], drawn=True)
            lines.put(stream, "", drawn=True)

        threading.Thread(target=draw, daemon=True).start()
        try:
            yield
        finally:
            ended.set()

    def result(self, result: "BaseModel", text: str) -> None:
        """End a command: its result as JSON, or the text. A number that is not finite becomes null."""
        Output.ended = True
        unwritten()  # a slow reader gets what was said before, and the whole result
        if self.as_json:
            # numpy's numbers and arrays have tolist.
            plain = to_jsonable_python(
                result.model_dump(by_alias=True), inf_nan_mode="null", fallback=lambda value: value.tolist()
            )
            print_line(sys.stdout, json.dumps(plain, allow_nan=False))
        else:
            for line in text.split("\n"):
                print_line(sys.stdout, line)


def print_line(stream: TextIO, text: str) -> None:
    """Print a line; where a rover depends on this process, queue it.

    Raises FileError if it cannot be written.
    """
    if Output.lines is not None:
        Output.lines.put(stream, text)
        return
    try:
        print(printable(text), file=stream, flush=True)
    except OSError as error:
        # Or Python would try again at its end, and print its own message.
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
        raise FileError(f"standard output cannot be written: {error.strerror}") from error


def unwritten() -> str:
    """Wait until the queued output is written; return the reason why the result is not, "" if it is."""
    if (lines := Output.lines) is None:
        return ""
    if not lines.drained():
        return "the reader takes no data"
    return str(lines.failure.strerror) if lines.failure else ""


LINE_S = 15.0
"""Time between two lines of progress."""


@contextlib.contextmanager
def progress(total: int, unit: str) -> Iterator[Callable[[int, object], None]]:
    """Give a function that shows how many of ``total`` are done, and a text: a bar, or a line now and then.

    It writes to stderr, a bar on a terminal.
    """
    from rich.console import Console
    from rich.progress import MofNCompleteColumn, Progress, TextColumn

    console, printed_s = Console(stderr=True), time.monotonic()

    def line(done: int, text: object) -> None:
        nonlocal printed_s
        if time.monotonic() - printed_s >= LINE_S:
            printed_s = time.monotonic()
            print(f"{done} of {total} {unit} {text}".rstrip(), file=sys.stderr, flush=True)

    if not console.is_terminal:
        yield line
        return
    columns = (MofNCompleteColumn(), TextColumn(unit), TextColumn("{task.fields[text]}"))
    with Progress(*Progress.get_default_columns(), *columns, console=console) as bar:
        task = bar.add_task("", total=total, text="")
        yield lambda done, text: bar.update(task, completed=done, text=str(text))
