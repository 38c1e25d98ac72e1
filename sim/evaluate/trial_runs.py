"""Random trials of one policy through the stack, and the words of a result."""

import itertools
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import Progress

from sim.evaluate.evaluate import Evaluation, tally
from sim.evaluate.results import StackDrive, StackResult
from sim.learn.progress import progress_lines
from sim.stack.estimates import summary, words
from sim.stack.trials import Stack, drive_all


def evaluate_stack(stack: Stack, trials: int, processes: int | None) -> tuple[Evaluation, StackResult]:
    """Drive trials through a stack; return their outcomes and the stack's result. Raises WorkerDied."""
    began = time.monotonic()
    with progress(trials) as done:
        driven = drive_all(stack, trials, processes, done)
    wall_s = time.monotonic() - began
    driven_s = sum(stack.course(number).horizon_s for number in range(trials))
    return tally(driven), StackResult(
        overruns=sum(trial.overruns for trial in driven),
        wall_s=wall_s,
        times_real_time=driven_s / wall_s,
        estimate=summary([trial.belief for trial in driven], [trial.parked for trial in driven]),
        drives=[
            StackDrive(
                trial=number,
                parked=trial.parked,
                reason=trial.reason,
                error_m=trial.error_m,
                error_rad=trial.error_rad,
                verdict=trial.belief.verdict,
                probability=trial.belief.probability,
            )
            for number, trial in enumerate(driven)
        ],
    )


@contextmanager
def progress(total: int) -> Iterator[Callable[[], None]]:
    """Show the progress of trials on stderr, of which the block reports each."""
    console = Console(stderr=True)
    if not console.is_terminal:
        counted, line = itertools.count(1), progress_lines()
        yield lambda: line(f"{next(counted)} of {total} trials")
        return
    with Progress(console=console, transient=True) as bar:
        task = bar.add_task("trials", total=total)
        yield lambda: bar.advance(task)


def result_words(found: Evaluation, stack: StackResult | None) -> Iterator[str]:
    """Yield lines about an evaluation, and about the stack if it was driven through one."""
    low, high = found.success_ci95
    yield f"{found.success_rate:.1%} of {found.trials} trials parked (95 % interval {low:.1%} to {high:.1%})"
    for name, spread, unit in (
        ("final position error", found.error_m, "mm"),
        ("final heading error", found.error_rad, "mrad"),
    ):
        p50, p95, largest = (1000 * error for error in (spread.p50, spread.p95, spread.max))
        yield f"{name}: median {p50:.0f}, 95th percentile {p95:.0f}, largest {largest:.0f} {unit}"
    for reason, count in found.failures.items():
        yield f"not parked, {reason}: {count}"
    if stack:
        yield from words(stack.estimate)
        yield f"{stack.times_real_time:.0f} times real time"
