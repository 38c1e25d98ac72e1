"""Workers of a training: this process, processes on this machine, or a Dask cluster (``cluster.py``).

Processes are spawned, never forked: numba and cffi do not survive a fork.
"""

import gc
import multiprocessing
import os
import pickle
import signal
from collections.abc import Callable, Sized
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from functools import lru_cache, partial
from multiprocessing.context import SpawnContext, SpawnProcess
from types import TracebackType
from typing import Any, Protocol, Self, TypeVar

from rover_ncp.core.errors import RoverNcpError, UsageError
from rover_ncp.core.spawned import end_with_parent, starting_processes

AnswerT = TypeVar("AnswerT", bound=Sized)


class WorkerDied(RoverNcpError):
    """A worker process ended while it had work, or answered what is no result."""


class Workers(Protocol):
    """The part of an executor of ``concurrent.futures`` that trainings need."""

    @property
    def count(self) -> int:
        """Tasks that run at the same time."""

    def submit(self, function: Callable[..., Any], /, *arguments: Any) -> Future[Any]:
        """Call a function in a worker."""


class Inline:
    """The executor that calls each function at once, in this process."""

    count = 1

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        pass

    def submit(self, function: Callable[..., Any], /, *arguments: Any) -> Future[Any]:
        """Call a function; its exceptions are raised here."""
        future: Future[Any] = Future()
        future.set_result(function(*arguments))
        return future


class _Spawning(SpawnContext):
    """Starts processes for one pool, and knows them."""

    def __init__(self) -> None:
        super().__init__()
        self.started: list[SpawnProcess] = []

    def Process(self, *arguments: Any, **options: Any) -> SpawnProcess:  # type: ignore[override]  # noqa: N802
        """Make a process."""
        self.started.append(SpawnProcess(*arguments, **options))
        return self.started[-1]


class ProcessPool:
    """Processes on this machine. An error in its context kills them at once, and no others of this program.

    Raises WorkerDied, with some advice, if one of them dies. They end when this process dies.
    """

    def __init__(self, count: int, advice: str = "") -> None:
        self.count = count
        self._advice = advice
        self._context = _Spawning()
        self._executor = ProcessPoolExecutor(count, self._context, end_with_parent)

    def __enter__(self) -> Self:
        return self

    def submit(self, function: Callable[..., Any], /, *arguments: Any) -> Future[Any]:
        """Call a function in the next idle process; errors of this project arrive as UsageError."""
        with starting_processes():  # the executor starts a process where none is idle
            return self._executor.submit(_call, function, *arguments)

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        broken = isinstance(error, BrokenProcessPool)  # then the executor ends the other processes
        if error is not None and not broken:
            self._executor.shutdown(wait=False, cancel_futures=True)
            for process in self._context.started:
                process.kill()  # it holds nothing that could be left half-done
        self._executor.shutdown()
        if broken:
            raise WorkerDied(f"a worker process {self._ending()} unexpectedly{self._advice}") from error

    def _ending(self) -> str:
        """Return how the process ended that the executor did not end."""
        for process in self._context.started:
            code = process.exitcode
            if code is not None and code not in {0, -signal.SIGTERM}:
                how = f"by {signal.Signals(-code).name}" if code < 0 else f"with exit code {code}"
                return f"ended {how}"
        return "ended"


def _call(function: Callable[..., Any], *arguments: Any) -> Any:
    try:
        return function(*arguments)
    except RoverNcpError as error:  # not all of them can be unpickled
        raise UsageError(str(error)) from None


def local_workers(count: int) -> Inline | ProcessPool:
    """Return so many workers on this machine; one is this process."""
    return Inline() if count == 1 else ProcessPool(count)


def answer(call: Future[Any], kind: type[AnswerT], count: int) -> AnswerT:
    """Return what a worker answered: ``count`` results. Raises WorkerDied for anything else.

    Only a worker of a cluster, which may run another program, can answer anything else.
    """
    found = call.result()
    if not isinstance(found, kind) or len(found) != count:
        raise WorkerDied(
            f"a worker answered {type(found).__name__}, expected {count} results in {kind.__name__}"
        )
    return found


def made_in_each_process(make: Callable[[], Callable[..., Any]]) -> Callable[..., Any]:
    """Return a function that each process makes with ``make``, which must be picklable, on its first call.

    A process keeps the last function that it made.
    """
    return partial(_call_made, pickle.dumps(make))


def _call_made(make: bytes, *arguments: Any) -> Any:
    return _made(make)(*arguments)


@lru_cache(maxsize=1)
def _made(make: bytes) -> Callable[..., Any]:
    made: Callable[..., Any] = pickle.loads(make)()
    if multiprocessing.parent_process() is not None:
        gc.freeze()  # imports leave a million objects, which need not be gone through again
    return made


def available_processes() -> int:
    """Return the number of cores that this process may use."""
    affinity = getattr(os, "sched_getaffinity", None)  # macOS has none
    return len(affinity(0)) if affinity else os.cpu_count() or 1
