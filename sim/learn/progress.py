"""Progress of a long command on stderr: a bar on a terminal, else a line now and then."""

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

if TYPE_CHECKING:
    from sim.learn.agents import Snapshot
    from sim.learn.robust import Generation


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
def train_progress(iterations: int) -> "Iterator[Callable[[Snapshot | Generation], None]]":
    """Give a function that shows a search as it is now: iterations, results and speed."""
    console = Console(stderr=True)
    if not console.is_terminal:
        line = progress_lines()
        yield lambda now: line(f"{now.iterations} of {iterations} iterations, {now.summary}")
        return
    with Progress(
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[summary]}  {task.fields[speed]}"),
        TimeRemainingColumn(),
        console=console,
    ) as bar:
        task = bar.add_task("", total=iterations, summary="", speed="starting")

        def show(now: "Snapshot | Generation") -> None:
            speed = bar.tasks[0].speed
            text = f"{speed:.3g} iterations/s" if speed else ""
            bar.update(task, completed=now.iterations, summary=now.summary, speed=text)

        yield show
