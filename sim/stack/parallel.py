"""Trials of a stack spread over processes. What comes of a trial depends on its number alone."""

import multiprocessing
import os
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool

from rover_ncp.core.errors import RoverNcpError
from sim.learn.workers import starting_processes
from sim.stack.trials import Driven, Stack

_WORTH_A_PROCESS = 6
"""Fewer trials take no longer than a process takes to start."""

_stack: Stack | None = None


class WorkerDied(RoverNcpError):
    """A process that drove trials ended without being asked to."""


def drive_all(
    stack: Stack, count: int, processes: int | None, on_done: Callable[[], None] = lambda: None
) -> list[Driven]:
    """Drive trials 0 to ``count`` − 1 of a stack; ``on_done`` is called after each. Raises WorkerDied.

    ``processes`` is by default as many as there are cores and work for.
    """
    hands = processes or min(len(os.sched_getaffinity(0)), max(count // _WORTH_A_PROCESS, 1))
    found: dict[int, Driven] = {}
    if hands == 1:
        for number in range(count):
            found[number] = stack.drive(number)
            on_done()
        return list(found.values())
    # Spawned, never forked: numba and cffi do not survive a fork.
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(hands, context, _take_on, (stack,)) as pool:
        try:
            with starting_processes():  # the pool starts them as work is handed in
                waiting = {pool.submit(_drive, number): number for number in range(count)}
            for done in as_completed(waiting):
                found[waiting[done]] = done.result()
                on_done()
        except BrokenProcessPool as error:
            raise WorkerDied("a process that drove trials ended without being asked to") from error
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
    return [found[number] for number in range(count)]


def _take_on(stack: Stack) -> None:
    global _stack  # noqa: PLW0603  # a pool hands on what all its tasks share in no other way
    _stack = stack


def _drive(number: int) -> Driven:
    assert _stack is not None  # the pool took it on first
    return _stack.drive(number)
