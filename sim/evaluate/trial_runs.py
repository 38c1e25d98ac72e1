"""Random trials of one policy through the stack, and the words of a result."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from rich.progress import Progress

from rover_ncp.core.console import Output
from sim.evaluate.evaluate import Evaluation, tally
from sim.stack.estimates import summary, words
from sim.stack.trials import Stack, drive_all


def evaluate_stack(
    stack: Stack, trials: int, processes: int | None, output: Output
) -> tuple[Evaluation, dict[str, Any]]:
    """Drive trials through a stack; return their outcomes and further fields. Raises WorkerDied."""
    began = time.monotonic()
    with _progress(output, trials) as done:
        driven = drive_all(stack, trials, processes, done)
    wall_s = time.monotonic() - began
    driven_s = sum(stack.course(number).horizon_s for number in range(trials))
    return tally(driven), {
        **{
            #: of all trials
            name: sum(getattr(trial, name) for trial in driven)
            for name in ("bytes_to_base", "bytes_from_base", "overruns")
        },
        "wall_s": wall_s,
        "times_real_time": driven_s / wall_s,
        "estimate": summary([trial.belief for trial in driven], [trial.parked for trial in driven]),
    }


@contextmanager
def _progress(output: Output, total: int) -> Iterator[Callable[[], None]]:
    with Progress(console=output.console, transient=True, disable=not output.console.is_terminal) as progress:
        task = progress.add_task("trials", total=total)
        yield lambda: progress.advance(task)


def result_words(found: Evaluation, more: dict[str, Any]) -> Iterator[str]:
    """Yield lines about an evaluation and the further fields of a stack."""
    low, high = found.success_ci95
    yield f"{found.success_rate:.1%} of {found.trials} trials parked (95 % interval {low:.1%} to {high:.1%})"
    for name, spread, unit in (
        ("final position error", found.error_m, "mm"),
        ("final heading error", found.error_rad, "mrad"),
    ):
        p50, p95, largest = (1000 * error for error in spread)
        yield f"{name}: median {p50:.0f}, 95th percentile {p95:.0f}, largest {largest:.0f} {unit}"
    for reason, count in found.failures.items():
        yield f"not parked, {reason}: {count}"
    if more:
        yield f"{more['bytes_to_base']} bytes to the bases, {more['bytes_from_base']} from them"
        yield from words(more["estimate"])
        yield f"{more['times_real_time']:.0f} times real time"
