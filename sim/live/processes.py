"""The three processes of a run on this machine: mock Pioneer, bridge, deploy, over loopback TCP and Zenoh.

Each is the very command a user would type, started from this interpreter. Whatever happens, leaving the
``with`` block ends all of them, the driver first: asked (SIGTERM), then, when one does not listen, killed.
"""

import contextlib
import functools
import json
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple, Self

from rover_ncp.core.errors import RoverNcpError
from sim.faults.outlet import Outlet

READY_TIMEOUT_S = 30.0
STOP_TIMEOUT_S = 5.0
APPLIED = "applied "
"""How the line begins in which a child answers what it was given."""
APPLIED_TIMEOUT_S = 5.0
TRUTH = "truth.csv"


class ProcessError(RoverNcpError):
    """A process of the run failed; carries its last line and its exit code."""

    def __init__(self, name: str, code: int, words: str) -> None:
        super().__init__(f"{name}: {words}" if words else f"{name} ended with exit code {code}")
        self.exit_code = code if code > 0 else 1


@functools.cache
def compile_driver() -> None:
    """Compile the driver's kernels if they are not on disk yet, before anything waits for a driver.

    After an installation that takes 8 s of CPU time, and on a busy machine longer than any timeout here.
    """
    from deploy.drive.controller import Controller
    from deploy.estimator.settings import EstimatorSettings
    from rover_ncp.circuit.policy_file import load_policy
    from rover_ncp.course.course import load_course

    Controller(load_policy("parking"), load_course("parking"), EstimatorSettings())


@contextlib.contextmanager
def uninterrupted() -> Iterator[None]:
    """Defer Ctrl-C and SIGTERM, so that a started process is registered before the run ends."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    noted: list[int] = []
    numbers = (signal.SIGINT, signal.SIGTERM)
    before = {number: signal.signal(number, lambda got, _: noted.append(got)) for number in numbers}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        for got in noted:
            signal.raise_signal(got)


@dataclass(frozen=True)
class Finished:
    """How a process ended: exit code, its one JSON object (empty if none), its last line for people."""

    code: int
    result: dict[str, Any]
    last_line: str


class Applied(NamedTuple):
    """A child's answer, in ns: when it applied what it was given, on the machine's monotonic clock, and how
    late its loop ended a turn at worst since the answer before."""

    t_ns: int
    late_ns: int


class Process:
    """A ``rover-ncp`` command as a child process. Its output goes to files, so that no pipe can fill up.

    ``module`` is the module that Python runs, for example a wrapper around the command; ``reads_lines`` opens
    its standard input for `tell`; ``outlet`` is the kind of `Outlet` that takes its output.
    """

    def __init__(
        self,
        command: str,
        arguments: Sequence[str],
        log_dir: Path,
        module: str = "rover_ncp",
        *,
        reads_lines: bool = False,
        outlet: str = "",
    ) -> None:
        self.command = command
        self._result = log_dir / f"{command}.json"
        self._log = log_dir / f"{command}.log"
        self.outlet = Outlet(outlet, self._log) if outlet else None
        with self._result.open("wb") as out, self._log.open("wb") as err:
            self._child = subprocess.Popen(
                # -P: the user's folder may hold a sim/ or a numba.py of its own.
                [sys.executable, "-P", "-m", module, command, *arguments, "--json"],
                stdin=subprocess.PIPE if reads_lines else subprocess.DEVNULL,
                stdout=self.outlet.fd if self.outlet else out,
                stderr=self.outlet.fd if self.outlet else err,
                # A terminal's Ctrl-C must reach the parent alone: it ends the driver first, then the others.
                start_new_session=True,
            )

    @property
    def pid(self) -> int:
        """The process id."""
        return self._child.pid

    @property
    def running(self) -> bool:
        """Whether it has not ended yet."""
        return self._child.poll() is None

    def wait_for_line(self, start: str, timeout_s: float = READY_TIMEOUT_S) -> str:
        """Return what follows ``start`` on its first line for people that begins so. Raises ProcessError."""
        deadline = time.monotonic() + timeout_s
        while True:
            running = self.running  # asked before its words are read: last words count
            for line in self._lines():
                if line.startswith(start):
                    return line.removeprefix(start).strip()
            if not running:
                raise self.failure()
            if time.monotonic() > deadline:
                raise ProcessError(self.command, 1, f"not ready after {timeout_s:.0f} s")
            time.sleep(0.02)

    def wait(self, timeout_s: float) -> Finished:
        """Wait for its end. Raises ProcessError after ``timeout_s``."""
        try:
            self._child.wait(timeout_s)
        except subprocess.TimeoutExpired as error:
            raise ProcessError(self.command, 1, f"still running after {timeout_s:.0f} s") from error
        return self._finished()

    def tell(self, line: str) -> Applied:
        """Write a line to its standard input, and wait for its answer. Raises ProcessError without one."""
        stdin = self._child.stdin
        assert stdin is not None  # started with reads_lines

        def write() -> None:
            with contextlib.suppress(BrokenPipeError):
                stdin.write(f"{line}\n".encode())
                stdin.flush()

        return self.answer_to(write)

    def answer_to(self, action: Callable[[], None]) -> Applied:
        """Wait for the process's answer to an action. Raises ProcessError without one."""
        known = len(self._answers())
        action()
        deadline = time.monotonic() + APPLIED_TIMEOUT_S
        while len(answers := self._answers()) == known:
            if not self.running:
                raise self.failure()
            if time.monotonic() > deadline:
                raise ProcessError(self.command, 1, f"no answer after {APPLIED_TIMEOUT_S:.0f} s")
            time.sleep(0.005)
        return answers[known]

    def send_signal(self, number: int) -> None:
        """Send it a signal, if it still runs."""
        if self.running:
            self._child.send_signal(number)

    def stop(self) -> Finished:
        """End it: SIGTERM, and SIGKILL when it does not listen."""
        self.send_signal(signal.SIGTERM)
        if self._child.stdin is not None:
            with contextlib.suppress(BrokenPipeError):
                self._child.stdin.close()
        try:
            self._child.wait(STOP_TIMEOUT_S)
        except subprocess.TimeoutExpired:
            self._child.kill()
            self._child.wait()
        if self.outlet is not None:
            self.outlet.close()
        return self._finished()

    def failure(self) -> ProcessError:
        """Return its unwanted end as an error."""
        done = self._finished()
        return ProcessError(self.command, done.code, done.last_line)

    def _finished(self) -> Finished:
        result: dict[str, Any] = {}
        with contextlib.suppress(json.JSONDecodeError):
            result = json.loads(self._result.read_text(errors="replace"))
        lines = self._lines()
        return Finished(self._child.wait(), result, lines[-1].removeprefix("rover-ncp: ") if lines else "")

    def _answers(self) -> list[Applied]:
        answers = [line.split() for line in self._lines() if line.startswith(APPLIED)]
        fields = [dict(word.split("=", 1) for word in words[1:3]) for words in answers]
        return [Applied(int(each["t_ns"]), int(each["late_ns"])) for each in fields]

    def _lines(self) -> list[str]:
        # Only whole lines: what is being written at this moment is not yet said.
        text = self._log.read_text(errors="replace")
        return text[: text.rfind("\n") + 1].splitlines()


class LiveRun:
    """Mock, bridge and deploy, ready one after the other; logs and the mock's truth land in ``folder``."""

    def __init__(self, folder: Path, *, mock: Sequence[str] = (), bridge: Sequence[str] = ()) -> None:
        self.folder = folder
        self.truth = folder / TRUTH
        self.processes: dict[str, Process] = {}
        self._mock_arguments = mock
        self._bridge_arguments = bridge
        self.robot = ""

    def __enter__(self) -> Self:
        self.folder.mkdir(parents=True, exist_ok=True)
        try:
            mock = self._start(
                "mock", "--listen", "127.0.0.1:0", "--truth", str(self.truth), *self._mock_arguments
            )
            address = mock.wait_for_line("listening on ")
            bridge = self._start(
                "bridge", "--base", f"tcp/{address}", "--listen", "tcp/127.0.0.1:0", *self._bridge_arguments
            )
            ready = dict(part.split("=", 1) for part in bridge.wait_for_line("ready ").split())
            self.robot = ready["zenoh"]
        except BaseException:
            self._stop_all()
            raise
        return self

    def deploy(self, *arguments: str) -> Process:
        """Start the driver."""
        compile_driver()
        return self._start("deploy", "--robot", self.robot, *arguments)

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stop_all()

    def _start(self, command: str, *arguments: str) -> Process:
        with uninterrupted():
            process = self.processes[command] = Process(command, arguments, self.folder)
        return process

    def _stop_all(self) -> None:
        # The last started ends first: the driver gives the motors back while the bridge still listens.
        for process in reversed(self.processes.values()):
            process.stop()
