"""Teams, and other work, in processes of their own.

Processes are spawned, never forked: numba and cffi do not survive a fork. A worker whose parent is gone,
however it went, finds its pipe closed and ends.
"""

import gc
import multiprocessing
import os
import signal
import threading
import traceback
from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import closing, contextmanager, suppress
from functools import partial
from itertools import pairwise
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import Any, NamedTuple, Protocol, Self

from rover_ncp.core.errors import RoverNcpError, UsageError
from sim.learn.team import AgentState, Plan, Rounds, Team

_JOIN_S = 5.0
_MOST_AHEAD = 4
"""Answers of a process that may wait for those of slower ones."""


class WorkerDied(RoverNcpError):
    """A training process ended without being asked to."""


class _Failure(NamedTuple):
    """Answer of a worker that cannot go on; errors themselves do not all survive a pipe."""

    text: str
    is_users: bool


class _End:
    """Message of a worker after the last of several answers."""


class Workers(Protocol):
    """Something that advances agents."""

    def rounds(self, agents: Sequence[AgentState], targets: Sequence[int]) -> Rounds:
        """Give all agents, in order, after each of these numbers of candidates, which rise.

        Work for later rounds may have begun; closing the iterator ends it.
        """


def split(agents: Sequence[AgentState], count: int) -> list[list[AgentState]]:
    """Return up to ``count`` groups of neighbours whose sizes differ by at most one."""
    count = min(count, len(agents))
    bounds = [len(agents) * i // count for i in range(count + 1)]
    return [list(agents[a:b]) for a, b in pairwise(bounds)]


def available_processes() -> int:
    """Return the number of cores that this process may use."""
    affinity = getattr(os, "sched_getaffinity", None)  # macOS has none
    return len(affinity(0)) if affinity else os.cpu_count() or 1


class Inline:
    """One team in this very process."""

    def __init__(self, plan: Plan) -> None:
        self._team = Team(plan)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        pass

    def rounds(self, agents: Sequence[AgentState], targets: Sequence[int]) -> Rounds:
        """Give all agents after each of these numbers of candidates."""
        return self._team.rounds(agents, targets)


class Processes:
    """As many copies of a function, each in a process of its own on this machine.

    ``make`` builds the function there, on the first call. A context manager: leaving it ends the processes
    at once.
    """

    def __init__(self, make: Callable[[], Callable[..., Any]], count: int) -> None:
        self.count = count
        self._make = make
        self._workers: list[tuple[BaseProcess, Connection]] = []

    def __enter__(self) -> Self:
        context = multiprocessing.get_context("spawn")
        try:
            with starting_processes():
                for number in range(self.count):
                    ours, theirs = context.Pipe()
                    process = context.Process(
                        target=_work, args=(theirs, self._make), name=f"train-{number}", daemon=True
                    )
                    process.start()
                    theirs.close()
                    self._workers.append((process, ours))
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *error: object) -> None:
        for process, connection in self._workers:
            process.kill()  # it holds nothing that could be left half-done
            process.join()
            process.close()
            connection.close()
        self._workers.clear()

    def call(self, calls: Sequence[tuple[Any, ...]]) -> list[Any]:
        """Call the function once in each process, with these arguments; return what comes back, in order.

        Raises WorkerDied, and UsageError for what the function says the user did wrong.
        """
        busy = list(zip(self._workers, calls, strict=False))
        for (process, connection), arguments in busy:
            _send(process, connection, arguments)
        return [_answer(process, connection) for (process, connection), _ in busy]

    def stream(self, calls: Sequence[tuple[Any, ...]]) -> Generator[list[Any], None, None]:
        """Call the function, which gives an iterator, once in each process; give what comes back together.

        The processes do not wait for each other. They wait for the consumer only when they are some answers
        ahead. A consumer that stops early closes the iterator and can then call again. Raises as ``call``.
        """
        processes = {ours: process for (process, ours), _ in zip(self._workers, calls, strict=False)}
        for (connection, process), arguments in zip(processes.items(), calls, strict=True):
            _send(process, connection, arguments)
        answers: dict[Connection, deque[Any]] = {connection: deque() for connection in processes}
        going = set(processes)
        try:
            while going:
                ready = wait([each for each in going if len(answers[each]) < _MOST_AHEAD])
                for connection in going.intersection(ready):
                    answer = _answer(processes[connection], connection)
                    if isinstance(answer, _End):
                        going.remove(connection)
                    else:
                        answers[connection].append(answer)
                while all(answers.values()):
                    yield [waiting.popleft() for waiting in answers.values()]
        except GeneratorExit:
            for connection in going:
                _send(processes[connection], connection, None)
            for connection in going:
                while not isinstance(_answer(processes[connection], connection), _End):
                    pass
            raise


class LocalProcesses(Processes):
    """Teams on the cores of this machine."""

    def __init__(self, plan: Plan, count: int) -> None:
        super().__init__(partial(_team, plan), count)

    def rounds(self, agents: Sequence[AgentState], targets: Sequence[int]) -> Rounds:
        """Give all agents after each of these numbers of candidates. Raises WorkerDied."""
        with closing(self.stream([(group, targets) for group in split(agents, self.count)])) as answers:
            for parts in answers:
                yield [agent for part in parts for agent in part]


def _team(plan: Plan) -> Callable[..., Rounds]:
    return Team(plan).rounds


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


def _send(process: BaseProcess, connection: Connection, message: Any) -> None:
    try:
        connection.send(message)
    except OSError as error:
        raise _death(process) from error


def _answer(process: BaseProcess, connection: Connection) -> Any:
    try:
        answer = connection.recv()
    except (EOFError, OSError) as error:
        raise _death(process) from error
    if isinstance(answer, _Failure):
        if answer.is_users:
            raise UsageError(answer.text)
        raise RuntimeError(f"{process.name} failed:\n{answer.text}")
    return answer


def _death(process: BaseProcess) -> WorkerDied:
    process.join(_JOIN_S)
    code = process.exitcode
    how = f"by {signal.Signals(-code).name}" if code is not None and code < 0 else f"with exit code {code}"
    return WorkerDied(f"training process {process.name} (pid {process.pid}) ended {how}")


def _work(connection: Connection, make: Callable[[], Callable[..., Any]]) -> None:
    """Serve a parent until its end of the pipe closes."""
    function: Callable[..., Any] | None = None
    with suppress(EOFError, BrokenPipeError, ConnectionResetError):
        while True:
            arguments = connection.recv()
            if arguments is None:  # the parent cancelled a stream that had ended
                continue
            answer: Any
            try:
                if function is None:
                    function = make()
                    gc.freeze()  # compilers leave a million objects, which need not be gone through again
                answer = function(*arguments)
                if isinstance(answer, Generator):
                    answer = _stream(connection, answer)
            except RoverNcpError as error:
                answer = _Failure(str(error), is_users=True)
            except Exception:
                answer = _Failure(traceback.format_exc(), is_users=False)
            connection.send(answer)


def _stream(connection: Connection, answers: Generator[Any, None, None]) -> _End:
    """Send all answers, until the parent cancels."""
    with closing(answers):
        for answer in answers:
            connection.send(answer)
            if connection.poll():
                connection.recv()
                break
    return _End()
