"""A run of real processes on this machine: mock, bridge and driver, over loopback TCP and Zenoh.

Each process is the command that a user would type. Leaving the ``with`` block of a run ends all of them.
"""

import json
import re
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any, NamedTuple, Self, TypeVar

from rover_ncp.core.errors import RoverNcpError
from rover_ncp.core.process import ClosedAtExit, Interrupts
from sim.park.growing_file import GrowingFile
from sim.park.truth import TRUTH, TruthReader

READY_TIMEOUT_S = 120.0
STOP_TIMEOUT_S = 20.0
APPLIED = "applied "
"""Begins the line in which a child reports that it applied a line of its input."""
APPLIED_TIMEOUT_S = 5.0

Found = TypeVar("Found")


class TimedOut(RoverNcpError):
    """A condition did not become true in time."""

    exit_code = 1


class ProcessError(RoverNcpError):
    """A child process failed. Carries its last line and its exit code."""

    def __init__(self, name: str, code: int, words: str) -> None:
        super().__init__(f"{name}: {words}" if words else f"{name} ended with exit code {code}")
        self.exit_code = code if code > 0 else 1


def wait_for(find: Callable[[], Found | None], timeout_s: float = 8.0, what: str = "a condition") -> Found:
    """Call ``find`` until it returns something true, and return that. Raises TimedOut."""
    deadline = time.monotonic() + timeout_s
    while not (found := find()):
        if time.monotonic() > deadline:
            raise TimedOut(f"timed out after {timeout_s:g} s waiting for {what}")
        time.sleep(0.005)
    return found


@contextmanager
def uninterrupted() -> Iterator[None]:
    """Defer termination signals, so that a started process is registered before the run ends."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    interrupts = Interrupts()
    try:
        with interrupts:
            yield
    finally:
        for number in interrupts.received:
            signal.raise_signal(number)


class Finished(NamedTuple):
    """How a process ended: exit code, its one JSON object (empty if none), its last line for people."""

    code: int
    result: dict[str, Any]
    last_line: str


class Applied(NamedTuple):
    """A child's answer to a line of input, in ns.

    When it applied the line, and the longest delay of its loop since the answer before. A mock says when its
    base last received anything. Moments are of the machine's monotonic clock.
    """

    t_ns: int
    late_ns: int
    heard_ns: int = 0


class Process(ClosedAtExit):
    """A ``rover-ncp`` command as a child process. Its output goes to files, so that no pipe can fill up.

    ``module`` is the module, or the script by its path, that Python runs, for example a wrapper around the
    command; ``reads_lines`` opens its standard input for `tell`; ``output`` is a file descriptor that takes
    its output.
    """

    def __init__(
        self,
        command: str,
        arguments: Sequence[str],
        log_dir: Path,
        module: str = "rover_ncp",
        *,
        reads_lines: bool = False,
        output: int | None = None,
    ) -> None:
        self.command = command
        self._result, log = log_dir / f"{command}.json", log_dir / f"{command}.log"
        self._log, self._lines = GrowingFile(log), list[str]()
        run = [module] if module.endswith(".py") else ["-m", module]
        with self._result.open("wb") as out, log.open("wb") as err:
            self._child = subprocess.Popen(
                # -P: the user's folder may hold a sim/ or a scipy.py of its own.
                [sys.executable, "-P", *run, command, *arguments, "--json"],
                stdin=subprocess.PIPE if reads_lines else subprocess.DEVNULL,
                stdout=out if output is None else output,
                stderr=err if output is None else output,
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
        """Return the rest of its first line for people that begins with ``start``.

        Raises ProcessError when it ends without that line, TimedOut after ``timeout_s``.
        """
        return self._wait_for_line(start, 0, timeout_s)

    def wait(self, timeout_s: float) -> Finished:
        """Wait for its end. Raises ProcessError after ``timeout_s``."""
        try:
            self._child.wait(timeout_s)
        except subprocess.TimeoutExpired as error:
            raise ProcessError(self.command, 1, f"still running after {timeout_s:.0f} s") from error
        return self._finished()

    def tell(self, line: str) -> Applied:
        """Write a line to its standard input, and wait for its answer. Raises as `wait_for_line`."""
        stdin = self._child.stdin
        assert stdin is not None  # started with reads_lines

        def write() -> None:
            with suppress(BrokenPipeError):
                stdin.write(f"{line}\n".encode())
                stdin.flush()

        return self.answer_to(write)

    def answer_to(self, action: Callable[[], None]) -> Applied:
        """Wait for the process's answer to an action. Raises as `wait_for_line`."""
        known = len(self._lines_that_begin(APPLIED))
        action()
        answer = self._wait_for_line(APPLIED, known, APPLIED_TIMEOUT_S)
        return Applied(**{name: int(value) for name, value in re.findall(r"(\w+_ns)=(\d+)", answer)})

    def send_signal(self, number: int) -> None:
        """Send it a signal, if it still runs."""
        if self.running:
            self._child.send_signal(number)

    def stop(self) -> Finished:
        """End it: SIGTERM, and SIGKILL if it still runs after `STOP_TIMEOUT_S`."""
        self.send_signal(signal.SIGCONT)
        self.send_signal(signal.SIGTERM)
        if self._child.stdin is not None:
            with suppress(BrokenPipeError):
                self._child.stdin.close()
        try:
            self._child.wait(STOP_TIMEOUT_S)
        except subprocess.TimeoutExpired:
            self._child.kill()
            self._child.wait()
        return self._finished()

    def close(self) -> None:
        """End it as `stop` does."""
        self.stop()

    def failure(self) -> ProcessError:
        """Return its unwanted end as an error."""
        done = self._finished()
        return ProcessError(self.command, done.code, done.last_line)

    def _wait_for_line(self, start: str, index: int, timeout_s: float) -> str:
        def find() -> str | None:
            running = self.running  # checked first: the last lines of a process that ended count
            lines = self._lines_that_begin(start)
            if len(lines) <= index and not running:
                raise self.failure()
            return lines[index] if len(lines) > index else None

        line = wait_for(find, timeout_s, f"a line '{start.strip()} …' from {self.command}")
        return line.removeprefix(start).strip()

    def _finished(self) -> Finished:
        result: dict[str, Any] = {}
        with suppress(json.JSONDecodeError):
            result = json.loads(self._result.read_text(errors="replace"))
        lines = self._lines_that_begin("")
        return Finished(self._child.wait(), result, lines[-1].removeprefix("rover-ncp: ") if lines else "")

    def _lines_that_begin(self, start: str) -> list[str]:
        self._lines += self._log.new_lines()
        return [line for line in self._lines if line.startswith(start)]


PIONEER, ROS2DDS, RMW_ZENOH = "tcp/{}", "ros2/tcp/{}", "ros2/tcp/{}#rmw=zenoh"
"""Forms of ``--base``, of HOST:PORT."""

Started = TypeVar("Started", bound=Process)


class LiveRun(ClosedAtExit):
    """Mock and bridge, ready one after the other, and drivers; logs and the mock's truth go to ``folder``.

    ``mock`` and ``bridge`` are more arguments for these commands. ``base_form`` makes the bridge's ``--base``
    of the mock's HOST:PORT. ``robot`` is the bridge's Zenoh address.
    """

    module = "rover_ncp"
    """Module that Python runs for bridge and drivers."""

    def __init__(
        self,
        folder: Path,
        *,
        mock: Sequence[str] = (),
        bridge: Sequence[str] = (),
        base_form: str = PIONEER,
    ) -> None:
        self.folder, self.robot = folder, ""
        self.processes: list[Process] = []
        self._deploys = 0
        self._mock_arguments, self._bridge_arguments = mock, bridge
        self._base_form = base_form

    def __enter__(self) -> Self:
        try:
            self.start()
        except BaseException:
            self.close()
            raise
        return self

    def start(self) -> None:
        """Start the mock and the bridge. Raises ProcessError or TimedOut."""
        self.folder.mkdir(parents=True, exist_ok=True)
        self.base = self.start_mock()
        self.start_bridge()

    def start_mock(self) -> str:
        """Start the mock; return the address HOST:PORT of the base."""
        truth = self.folder / TRUTH
        arguments = ["--listen", "127.0.0.1:0", "--truth", str(truth), "--fault", "-", *self._mock_arguments]
        self.mock = self.start_process(lambda: Process("mock", arguments, self.folder, reads_lines=True))
        address = self.mock.wait_for_line("listening on ")
        self.truth = TruthReader(truth)
        return address

    def start_bridge(self) -> None:
        """Start the bridge; the next one listens on the same address again."""
        listen = self.robot or "tcp/127.0.0.1:0"
        arguments = ["--base", self._base_form.format(self.base), "--listen", listen, *self._bridge_arguments]
        self.bridge = self.start_process(lambda: self.bridge_process(arguments))
        ready = dict(part.split("=", 1) for part in self.bridge.wait_for_line("ready ").split())
        self.robot = ready["zenoh"]

    def bridge_process(self, arguments: Sequence[str]) -> Process:
        """Return the bridge's process."""
        return Process("bridge", arguments, self.folder, self.module)

    def deploy(self, *arguments: str, robot: str = "") -> Process:
        """Start a driver; ``robot`` replaces the bridge's address."""
        self._deploys += 1
        # Several drivers may run at once, and each has its log.
        folder = self.folder / f"deploy-{self._deploys}" if self._deploys > 1 else self.folder
        folder.mkdir(exist_ok=True)
        arguments = ("--robot", robot or self.robot, *arguments)
        return self.start_process(lambda: Process("deploy", arguments, folder, self.module))

    def finish(self, driver: Process, timeout_s: float) -> Finished:
        """Wait for a driver's end, then end bridge and mock. Raises ProcessError if it did not drive."""
        done = driver.wait(timeout_s)
        self.bridge.stop()
        self.mock.stop()
        if done.code not in {0, 1} or not done.result:
            raise ProcessError(driver.command, done.code, done.last_line)
        return done

    def start_process(self, start: Callable[[], Started]) -> Started:
        """Start a process that ends with the run."""
        with uninterrupted():
            process = start()
            self.processes.append(process)
        return process

    def close(self) -> None:
        """End all processes, the last started first: a driver releases its lease while the bridge runs."""
        with uninterrupted(), ExitStack() as ending:
            for process in self.processes:
                ending.callback(process.stop)
