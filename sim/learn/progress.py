"""A training's progress bar; on a terminal only, always on stderr."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

if TYPE_CHECKING:
    from sim.learn.agents import Snapshot
    from sim.learn.robust import Generation


@contextmanager
def train_progress(iterations: int) -> "Iterator[Callable[[Snapshot | Generation], None]]":
    """Give a function that shows a search as it is now: iterations, results and speed."""
    console = Console(stderr=True)
    with Progress(
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[summary]}  {task.fields[speed]}"),
        TimeRemainingColumn(),
        console=console,
        disable=not console.is_terminal,
    ) as bar:
        task = bar.add_task("", total=iterations, summary="", speed="starting")

        def show(now: "Snapshot | Generation") -> None:
            speed = bar.tasks[0].speed
            text = f"{speed:.3g} iterations/s" if speed else ""
            bar.update(task, completed=now.iterations, summary=now.summary, speed=text)

        yield show
