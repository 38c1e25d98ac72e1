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
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import CancelledError, Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from functools import lru_cache, partial
from multiprocessing.context import SpawnContext, SpawnProcess
from types import TracebackType
from typing import Any, TypeAlias

from rover_ncp.core.errors import RoverNcpError, UsageError
from rover_ncp.core.spawned import end_with_parent, starting_processes
from sim.learn.settings import versions

CONNECT_S = 10.0
"""How long a scheduler has to answer, and then a first worker to be there."""
_RETRIES = 1000
"""Workers that may die on one task; Dask's own three would end a run on machines that come and go."""

Map: TypeAlias = Callable[..., Iterator[Any]]
"""Calls a function with each row of arguments, as the built-in ``map``, in workers."""

# A Dask worker may have several threads, but evaluators serve one at a time.
_one_task = threading.Lock()


class WorkerDied(RoverNcpError):
    """A worker process ended while it had work, or a cluster is gone."""


class _Spawning(SpawnContext):
    """Starts processes for one pool, and knows them."""

    def __init__(self) -> None:
        super().__init__()
        self.started: list[SpawnProcess] = []

    def Process(self, *arguments: Any, **options: Any) -> SpawnProcess:  # type: ignore[override]  # noqa: N802
        """Make a process."""
        self.started.append(SpawnProcess(*arguments, **options))
        return self.started[-1]


class ProcessPool(ProcessPoolExecutor):
    """Processes on this machine. Its context kills those that still work at its end, and no others.

    Raises WorkerDied if one of them dies. They end when this process dies. Errors of this project arrive as
    UsageError.
    """

    def __init__(self, count: int) -> None:
        self._spawning = _Spawning()
        self._calls: list[Future[Any]] = []
        super().__init__(count, self._spawning, end_with_parent)

    def submit(self, function: Callable[..., Any], /, *arguments: Any, **options: Any) -> Future[Any]:
        """Call a function in the next idle process."""
        with starting_processes():  # the executor starts a process where none is idle
            self._calls.append(super().submit(_call, function, *arguments, **options))
        return self._calls[-1]

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        broken = isinstance(error, BrokenProcessPool)  # then the executor ends the other processes
        if not broken and not all(call.done() for call in self._calls):
            self.shutdown(wait=False, cancel_futures=True)
            for process in self._spawning.started:
                if process.is_alive():
                    process.kill()  # it holds nothing that could be left half-done
        self.shutdown()
        if broken:
            raise WorkerDied("a worker process was killed (out of memory?) or crashed") from error


def _call(function: Callable[..., Any], *arguments: Any, **options: Any) -> Any:
    try:
        return function(*arguments, **options)
    except RoverNcpError as error:  # not all of them can be unpickled
        raise UsageError(str(error)) from None


@contextmanager
def local_workers(count: int) -> Iterator[Map]:
    """Give so many workers on this machine; one is this process."""
    if count == 1:
        yield map
    else:
        with ProcessPool(count) as pool:
            yield partial(_map, pool)


def _map(pool: ProcessPool, function: Callable[..., Any], *arguments: Iterable[Any]) -> Iterator[Any]:
    # Executor.map cancels calls when it is left early: its thread fails if processes are killed then.
    calls = [pool.submit(function, *row) for row in zip(*arguments, strict=False)]
    return (call.result() for call in calls)


@contextmanager
def cluster_workers(address: str) -> Iterator[Map]:
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
        executor, check = (
            client.get_executor(pure=False, retries=_RETRIES),
            partial(_call_if_same, versions()),
        )
        yield lambda function, *arguments: executor.map(partial(check, function), *arguments)
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
