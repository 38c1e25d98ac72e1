"""A training's progress bar; on a terminal only, always on stderr."""

from types import TracebackType
from typing import Protocol, Self

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn


class Progressing(Protocol):
    """A search between two iterations."""

    @property
    def iterations(self) -> int:
        """Iterations done."""

    @property
    def summary(self) -> str:
        """Its results in a few words."""


class TrainProgress:
    """Shows iterations, the results so far and the speed, while its context is open."""

    def __init__(self, iterations: int) -> None:
        console = Console(stderr=True)
        self._bar = Progress(
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn("{task.fields[summary]}  {task.fields[speed]}"),
            TimeRemainingColumn(),
            console=console,
            disable=not console.is_terminal,
        )
        self._task = self._bar.add_task("", total=iterations, summary="", speed="starting")

    def __enter__(self) -> Self:
        self._bar.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._bar.stop()

    def show(self, now: Progressing) -> None:
        """Show the search as it is now."""
        speed = self._bar.tasks[0].speed
        text = f"{speed:.3g} iterations/s" if speed else ""
        self._bar.update(self._task, completed=now.iterations, summary=now.summary, speed=text)
