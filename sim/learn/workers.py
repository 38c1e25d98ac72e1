"""Workers of a training: this process, processes on this machine, or a Dask cluster.

Processes are spawned, never forked: cffi does not survive a fork.

A cluster is trusted like this machine. Anyone who reaches a Dask scheduler can run code on its workers, and
any worker can run code here: Dask unpickles its answers. Every worker must have the same versions of what
decides a result.
"""

import gc
import logging
import multiprocessing
import os
import pickle
import signal
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import CancelledError, Executor, Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from functools import lru_cache, partial
from multiprocessing.context import SpawnContext, SpawnProcess
from types import TracebackType
from typing import Any, Protocol, Self

from rover_ncp.core.errors import RoverNcpError, UsageError
from rover_ncp.core.spawned import end_with_parent, starting_processes
from sim.learn.settings import versions

CONNECT_S = 10.0
"""How long a scheduler has to answer, and then a first worker to be there."""
_RETRIES = 1000
"""Workers that may die on one task; Dask's own three would end a run on machines that come and go."""

# A Dask worker may have several threads, but evaluators serve one at a time.
_one_task = threading.Lock()


class WorkerDied(RoverNcpError):
    """A worker process ended while it had work, or a cluster is gone."""


class Workers(Protocol):
    """The part of an executor of ``concurrent.futures`` that trainings need."""

    def map(self, function: Callable[..., Any], /, *arguments: Iterable[Any]) -> Iterator[Any]:
        """Call a function with each row of arguments; return the results in order."""


class Inline:
    """Calls each function in this process, when its result is needed."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        pass

    def map(self, function: Callable[..., Any], /, *arguments: Iterable[Any]) -> Iterator[Any]:
        """Call a function with each row of arguments; its exceptions are raised here."""
        return map(function, *arguments)


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
    """Processes on this machine. Its context kills those that still work at its end, and no others.

    Raises WorkerDied, with some advice, if one of them dies. They end when this process dies.
    """

    def __init__(self, count: int, advice: str = "") -> None:
        self._advice = advice
        self._context = _Spawning()
        self._executor = ProcessPoolExecutor(count, self._context, end_with_parent)
        self._calls: list[Future[Any]] = []

    def __enter__(self) -> Self:
        return self

    def submit(self, function: Callable[..., Any], /, *arguments: Any) -> Future[Any]:
        """Call a function in the next idle process; errors of this project arrive as UsageError."""
        with starting_processes():  # the executor starts a process where none is idle
            self._calls.append(self._executor.submit(_call, function, *arguments))
        return self._calls[-1]

    def map(self, function: Callable[..., Any], /, *arguments: Iterable[Any]) -> Iterator[Any]:
        """Call a function with each row of arguments; return the results in order."""
        calls = [self.submit(function, *row) for row in zip(*arguments, strict=False)]
        return (call.result() for call in calls)

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        broken = isinstance(error, BrokenProcessPool)  # then the executor ends the other processes
        if not broken and not all(call.done() for call in self._calls):
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


class _Cluster:
    """The workers of a Dask cluster."""

    def __init__(self, executor: Executor) -> None:
        self._executor = executor

    def map(self, function: Callable[..., Any], /, *arguments: Iterable[Any]) -> Iterator[Any]:
        """Call a function with each row of arguments; return the results in order."""
        call = partial(_call_if_same, versions(), function)
        calls = [self._executor.submit(call, *row) for row in zip(*arguments, strict=False)]
        return (future.result() for future in calls)


@contextmanager
def cluster_workers(address: str) -> Iterator[_Cluster]:
    """Give the workers of a Dask cluster; what still runs there at the end is cancelled.

    Raises UsageError for a scheduler or workers that are missing or unsuitable, and WorkerDied.
    """
    from distributed import Client, KilledWorker
    from distributed.comm.core import CommClosedError

    connect: Any = Client
    # Dask reports a connection that ends with tracebacks; this command does it in one line.
    for name in ("distributed", "distributed.core", "distributed.client"):
        logging.getLogger(name).setLevel(logging.CRITICAL)
    try:
        client = connect(address, timeout=CONNECT_S, set_as_default=False)
    except (OSError, ValueError, TypeError) as error:
        raise UsageError(f"no Dask scheduler answers at {address}") from error
    try:
        client.wait_for_workers(1, timeout=CONNECT_S)
        yield _Cluster(client.get_executor(pure=False, retries=_RETRIES))
    except TimeoutError as error:
        raise UsageError(f"the Dask scheduler at {address} has no workers") from error
    except (ModuleNotFoundError, pickle.PickleError) as error:
        raise UsageError(f"the workers at {address} lack rover-ncp: {error}") from error
    except (CancelledError, CommClosedError, KilledWorker) as error:
        raise WorkerDied(f"the Dask cluster at {address} is gone: {error}") from error
    finally:
        client.close()


def _call_if_same(wanted: Mapping[str, str], function: Callable[..., Any], *arguments: Any) -> Any:
    """Call a function on a worker. Raises UsageError for other versions than those of the client."""
    if versions() != wanted:
        raise UsageError(f"a worker has {versions()}, this machine {dict(wanted)}: results would differ")
    with _one_task:
        return function(*arguments)


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
