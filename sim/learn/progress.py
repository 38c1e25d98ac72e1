"""A training run's progress bar; on a terminal only, always on stderr."""

from types import TracebackType
from typing import Self

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from sim.learn.agents import Snapshot


class TrainProgress:
    """Shows iterations, the best and the median return, and the speed, while its context is open."""

    def __init__(self, iterations: int) -> None:
        console = Console(stderr=True)
        self._bar = Progress(
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn("best {task.fields[best]}  median {task.fields[median]}  {task.fields[speed]}"),
            TimeRemainingColumn(),
            console=console,
            disable=not console.is_terminal,
        )
        self._task = self._bar.add_task("", total=iterations, best="-", median="-", speed="starting")
        self._agents = 0

    def __enter__(self) -> Self:
        self._bar.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._bar.stop()

    def show(self, snapshot: Snapshot) -> None:
        """Show the agents as they stand."""
        speed = self._bar.tasks[0].speed
        self._bar.update(
            self._task,
            completed=snapshot.iterations,
            best=f"{snapshot.best.value:.4f}",
            median=f"{snapshot.median_return:.4f}",
            speed=f"{speed * len(snapshot.agents):.0f} iterations/s" if speed else "",
        )
