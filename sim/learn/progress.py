"""Progress of a long command on stderr: a bar on a terminal, else a line now and then."""

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    SpinnerColumn,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

LINE_S = 15.0
"""Time between two lines."""


def progress_lines() -> Callable[[str], None]:
    """Return a function that prints a text on stderr, unless it printed another one shortly before."""
    printed_s = time.monotonic()

    def line(text: str) -> None:
        nonlocal printed_s
        if time.monotonic() - printed_s >= LINE_S:
            printed_s = time.monotonic()
            print(text, file=sys.stderr, flush=True)

    return line


@contextmanager
def train_progress(total: int, unit: str) -> Iterator[Callable[[int, object], None]]:
    """Give a function that shows how many of ``total`` agents or generations are done, and the best."""
    console = Console(stderr=True)
    if not console.is_terminal:
        line = progress_lines()
        yield lambda done, summary: line(f"{done} of {total} {unit}, {summary}")
        return
    with Progress(
        SpinnerColumn(),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn(unit),
        TextColumn("{task.fields[summary]}"),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        console=console,
    ) as bar:
        task = bar.add_task("", total=total, summary="")
        yield lambda done, summary: bar.update(task, completed=done, summary=str(summary))
