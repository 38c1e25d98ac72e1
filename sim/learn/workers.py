"""Executors of the trainings: this process, processes on this machine, or a Dask cluster (``cluster.py``).

All take calls and give results as an executor of ``concurrent.futures`` does, and know how many calls they
run at the same time. Processes are spawned, never forked: numba and cffi do not survive a fork.
"""

import gc
import multiprocessing
import os
import pickle
import signal
import threading
import traceback
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from functools import lru_cache
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection
from multiprocessing.context import SpawnContext, SpawnProcess
from multiprocessing.process import BaseProcess
from typing import Any, Protocol, Self

from rover_ncp.core.errors import RoverNcpError, UsageError

_JOIN_S = 5.0


class WorkerDied(RoverNcpError):
    """A process that had work ended without being asked to."""


class Result(Protocol):
    """The part of a future of ``concurrent.futures`` that trainings need."""

    def result(self) -> Any:
        """Wait for the result, and return it or raise the error of the call."""


class Workers(Protocol):
    """The part of an executor of ``concurrent.futures`` that trainings need."""

    @property
    def count(self) -> int:
        """Tasks that run at the same time."""

    def submit(self, function: Callable[..., Any], /, *arguments: Any) -> Result:
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


class LocalProcesses:
    """Processes on this machine, which take calls in turn. Leaving its context ends them at once.

    A process whose parent has died finds its pipe closed and ends. No thread waits for the answers: the main
    thread receives them itself, where Ctrl-C interrupts it.
    """

    def __init__(self, count: int) -> None:
        self.count = count
        self._calls: deque[_Call] = deque()
        """The last call of each process, the one of longest ago first."""

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
                    self._calls.append(_Call(process, ours, (None, None)))
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *error: object) -> None:
        for call in self._calls:
            call.process.kill()  # it holds nothing that could be left half-done
            call.process.join()
            call.process.close()
            call.connection.close()

    def submit(self, function: Callable[..., Any], /, *arguments: Any) -> "_Call":
        """Call a function in the process that has been without a new call for longest.

        Waits until that one is idle. Raises WorkerDied if it has died.
        """
        last = self._calls[0]
        last.receive()
        call = _Call(last.process, last.connection)
        try:
            call.connection.send((function, arguments))
        except OSError as error:
            raise _death(call.process) from error
        self._calls.rotate(-1)
        self._calls[-1] = call
        return call


class _Call:
    """A call of a function in a process, with the result like that of a future."""

    def __init__(
        self,
        process: BaseProcess,
        connection: Connection,
        answer: tuple[Any, Exception | None] | None = None,
    ) -> None:
        self.process, self.connection = process, connection
        self._answer = answer

    def receive(self) -> tuple[Any, Exception | None]:
        """Wait for the answer: a value, or an error."""
        if self._answer is None:
            try:
                self._answer = self.connection.recv()
            except (EOFError, OSError) as error:
                raise _death(self.process) from error
        return self._answer

    def result(self) -> Any:
        """Return what the function returned. Raises WorkerDied, or RuntimeError for a programming error."""
        value, error = self.receive()
        if error is not None:
            raise error
        return value


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


class _Spawning(SpawnContext):
    """Starts processes for one pool, and knows them."""

    def __init__(self) -> None:
        super().__init__()
        self.started: list[SpawnProcess] = []

    def Process(self, *arguments: Any, **options: Any) -> SpawnProcess:  # type: ignore[override]  # noqa: N802
        """Make a process."""
        self.started.append(SpawnProcess(*arguments, **options))
        return self.started[-1]


@contextmanager
def process_pool(
    count: int, death: str, initializer: Callable[..., object] | None = None, *arguments: Any
) -> Iterator[ProcessPoolExecutor]:
    """Give an executor. An error in the block ends its processes at once, and no others of this program.

    Raises WorkerDied with the words of ``death`` if one of them dies.
    """
    context = _Spawning()
    with ProcessPoolExecutor(count, context, initializer, arguments) as pool:
        try:
            yield pool
        except BaseException as error:
            pool.shutdown(wait=False, cancel_futures=True)
            for process in context.started:
                process.kill()  # it holds nothing that could be left half-done
            if isinstance(error, BrokenProcessPool):
                raise WorkerDied(death) from error
            raise


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
