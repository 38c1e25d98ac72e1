"""Executors of the trainings: this process, processes on this machine, or a Dask cluster (``cluster.py``).

All are executors of ``concurrent.futures`` with the number of tasks that they run at the same time. Processes
are spawned, never forked: numba and cffi do not survive a fork.
"""

import gc
import multiprocessing
import os
import pickle
import signal
import threading
import traceback
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager, suppress
from functools import lru_cache
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from queue import SimpleQueue
from types import TracebackType
from typing import Any, Protocol, Self

from rover_ncp.core.errors import RoverNcpError, UsageError

_JOIN_S = 5.0


class WorkerDied(RoverNcpError):
    """A process that had work ended without being asked to."""


class Workers(Protocol):
    """An executor of ``concurrent.futures``."""

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


class LocalProcesses(ThreadPoolExecutor):
    """Processes on this machine, a thread for each of them. Leaving its context ends them at once.

    A process whose parent has died finds its pipe closed and ends.
    """

    def __init__(self, count: int) -> None:
        super().__init__(count)
        self.count = count
        self._workers: list[tuple[BaseProcess, Connection]] = []
        self._idle: SimpleQueue[tuple[BaseProcess, Connection]] = SimpleQueue()

    def __enter__(self) -> Self:
        context = multiprocessing.get_context("spawn")
        try:
            with starting_processes():
                for number in range(self.count):
                    ours, theirs = context.Pipe()
                    process = context.Process(
                        target=_serve, args=(theirs,), name=f"worker-{number}", daemon=True
                    )
                    process.start()
                    theirs.close()
                    self._workers.append((process, ours))
                    self._idle.put((process, ours))
        except BaseException:
            self.__exit__(None, None, None)
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for process, _ in self._workers:
            process.kill()  # it holds nothing that could be left half-done
        self.shutdown(cancel_futures=True)
        for process, connection in self._workers:
            process.join()
            process.close()
            connection.close()

    def submit(self, function: Callable[..., Any], /, *arguments: Any) -> Future[Any]:  # type: ignore[override]
        """Call a function in a process. Raises WorkerDied, and RuntimeError for a programming error."""
        return super().submit(self._call, function, arguments)

    def _call(self, function: Callable[..., Any], arguments: tuple[Any, ...]) -> Any:
        process, connection = worker = self._idle.get()
        try:
            connection.send((function, arguments))
            answer, error = connection.recv()
        except (EOFError, OSError) as lost:
            raise _death(process) from lost
        self._idle.put(worker)
        if error is not None:
            raise error
        return answer


def _death(process: BaseProcess) -> WorkerDied:
    process.join(_JOIN_S)
    code = process.exitcode
    how = f"by {signal.Signals(-code).name}" if code is not None and code < 0 else f"with exit code {code}"
    return WorkerDied(f"process {process.name} (pid {process.pid}) ended {how}")


def _serve(connection: Connection) -> None:
    """Call what a parent asks for, until its end of the pipe closes."""
    with suppress(EOFError, BrokenPipeError, ConnectionResetError):
        while True:
            function, arguments = connection.recv()
            answer: tuple[Any, Exception | None]
            try:
                answer = function(*arguments), None
            except RoverNcpError as error:  # of which not all survive a pipe
                answer = None, UsageError(str(error))
            except Exception:
                answer = None, RuntimeError(f"a worker failed:\n{traceback.format_exc()}")
            connection.send(answer)


class MadeOnce:
    """A function that each process makes for itself, on the first call: ``MadeOnce(make)(*arguments)``.

    ``make`` must be picklable if the calls run in other processes. These keep the last function they made.
    """

    def __init__(self, make: Callable[[], Callable[..., Any]]) -> None:
        self._make = make
        self._function: Callable[..., Any] | None = None

    def __call__(self, *arguments: Any) -> Any:
        """Call the function."""
        if self._function is None:
            self._function = self._make()
        return self._function(*arguments)

    def __reduce__(self) -> tuple[Callable[[bytes], "MadeOnce"], tuple[bytes]]:
        return _made_here, (pickle.dumps(self._make),)


@lru_cache(maxsize=1)
def _made_here(make: bytes) -> MadeOnce:
    gc.freeze()  # imports leave a million objects, which need not be gone through again
    return MadeOnce(pickle.loads(make))


def available_processes() -> int:
    """Return the number of cores that this process may use."""
    affinity = getattr(os, "sched_getaffinity", None)  # macOS has none
    return len(affinity(0)) if affinity else os.cpu_count() or 1


@contextmanager
def starting_processes() -> Iterator[None]:
    """Let a Ctrl-C wait until the end of the block, and keep it from processes spawned within for good.

    A terminal sends it to the whole group, and the parent alone decides. They inherit the blocked signal, so
    it cannot hit them even while their interpreter starts. Blocking it here does not hold it back: any
    thread of a library takes it instead, so it is also noted and passed on.
    """
    # The tracker unblocks SIGINT while it starts, so it has to start before we block it.
    resource_tracker.ensure_running()
    held: list[int] = []
    is_main = threading.current_thread() is threading.main_thread()
    handler = signal.signal(signal.SIGINT, lambda number, _: held.append(number)) if is_main else None
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        if is_main:
            signal.signal(signal.SIGINT, handler)
    if held and callable(handler):
        handler(signal.SIGINT, None)
