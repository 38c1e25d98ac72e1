"""Mock, bridge, proxied links and drivers as real processes, and the rover's true motion.

The mock reads the base's faults from its standard input. A wrapper around the command causes hangs
(`sim.faults.hang`), and proxies cause the faults of both links. No process under test has a hook for them.
"""

import signal
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from types import TracebackType
from typing import Self, TypeVar

from rover_ncp.core.errors import RoverNcpError
from sim.faults.proxy import Proxy
from sim.faults.scripted_driver import ScriptedDriver
from sim.faults.standstill import Motion, TruthReader
from sim.live.processes import Process, compile_driver, uninterrupted

SPEED_M_S = 0.12
"""Speed of a scripted driver."""
CREEP_M_S = 0.05
"""Speed above which the rover of a circuit counts as moving."""
HANGABLE = "sim.faults.hang"

Kept = TypeVar("Kept", bound=Process)


class TimedOut(RoverNcpError):
    """A condition did not become true in time."""

    exit_code = 1


class Unsafe(RoverNcpError):
    """The rover violated a safety requirement."""

    exit_code = 1


def wait_for(condition: Callable[[], bool], what: str, timeout_s: float = 8.0) -> None:
    """Wait until a condition holds. Raises TimedOut."""
    deadline = time.monotonic() + timeout_s
    while not condition():
        if time.monotonic() > deadline:
            raise TimedOut(f"timed out after {timeout_s:g} s waiting for {what}")
        time.sleep(0.01)


class Rig:
    """Mock, bridge, two proxies and drivers.

    ``robot`` is the bridge's address; ``through_proxy`` is its address by way of the proxy ``link``. The
    bridge reaches the base through the proxy ``line``. ``course`` is the course of circuits; ``mock`` and
    ``bridge`` are more arguments for these programs. ``outlet`` is the kind of `Outlet` that takes the
    bridge's output.
    """

    def __init__(
        self,
        folder: Path,
        course: Path,
        *,
        mock: Sequence[str] = (),
        bridge: Sequence[str] = (),
        outlet: str = "",
    ) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self.folder, self.course, self.robot = folder, course, ""
        self.processes: list[Process] = []
        self._scripted: list[ScriptedDriver] = []
        self._deploys, self._bridge_arguments, self._outlet = 0, bridge, outlet
        truth = folder / "truth.csv"
        try:
            arguments = ["--listen", "127.0.0.1:0", "--truth", str(truth), "--fault", "-", *mock]
            self.mock = self._start(lambda: Process("mock", arguments, folder, reads_lines=True))
            base = self.mock.wait_for_line("listening on ")
            self.line = self._start(lambda: Proxy(base, folder, "line"))
            self.start_bridge("tcp/127.0.0.1:0")
            self.link = self._start(lambda: Proxy(self.robot.removeprefix("tcp/"), folder, "link"))
            self.through_proxy = f"tcp/{self.link.address}"
            self.truth = TruthReader(truth)
            self.watcher = self.scripted_driver()
            """A driver that receives everything and sends nothing."""
            self.watcher.silent, self.watcher.requests_lease = True, False
        except BaseException:
            self.close()
            raise

    def _start(self, start: Callable[[], Kept]) -> Kept:
        with uninterrupted():
            process = start()
            self.processes.append(process)
        return process

    def start_bridge(self, listen: str | None = None) -> None:
        """Start the bridge; after a first start, listen on the same address again."""
        arguments = ["--base", f"tcp/{self.line.address}", "--listen", listen or self.robot]
        arguments += self._bridge_arguments
        self.bridge = self._start(
            lambda: Process("bridge", arguments, self.folder, HANGABLE, outlet=self._outlet)
        )
        ready = dict(part.split("=", 1) for part in self.bridge.wait_for_line("ready ").split())
        self.robot = ready["zenoh"]

    def deploy(self, *options: str, robot: str | None = None) -> Process:
        """Start the driver of a circuit."""
        compile_driver()
        self._deploys += 1
        folder = self.folder / f"deploy{self._deploys}"
        folder.mkdir(exist_ok=True)
        arguments = ["--robot", robot or self.robot, "--course", str(self.course), *options]
        return self._start(lambda: Process("deploy", arguments, folder, HANGABLE))

    def scripted_driver(self, robot: str | None = None, lease_s: float = 1.0) -> ScriptedDriver:
        """Start a driver of constant speed, in this process."""
        self._scripted.append(ScriptedDriver(robot or self.robot, lease_s))
        return self._scripted[-1]

    def motion(self) -> Motion | None:
        """Return the rover's newest true motion, or None before the mock wrote one."""
        rows = self.truth.read()
        return rows[-1] if rows else None

    def speed(self) -> float:
        """Return the rover's newest true speed, in m/s."""
        motion = self.motion()
        return motion.v if motion else 0.0

    def under_way(self, driver: ScriptedDriver, v: float = SPEED_M_S) -> ScriptedDriver:
        """Let a scripted driver drive, and wait until the rover does. Raises TimedOut."""
        driver.velocity = driver.velocity._replace(v=v)
        wait_for(lambda: abs(self.speed() - v) < 0.01, "the rover under a scripted driver")
        return driver

    def driven(self, deploy: Process) -> None:
        """Wait until a circuit moves the rover. Raises TimedOut or ProcessError."""
        wait_for(lambda: not deploy.running or abs(self.speed()) > CREEP_M_S, "the circuit to drive", 30.0)
        if not deploy.running:
            raise deploy.failure()

    def stood(self, since_ns: int, timeout_s: float = 6.0) -> float:
        """Wait until the rover stands; return how long after ``since_ns`` it stopped, in s. Raises NotStill.

        ``since_ns`` is a time of the machine's monotonic clock, which the mock's simulation follows.
        """
        return self.truth.stood_after(since_ns, timeout_s)

    def late_s(self) -> float:
        """Return the greatest delay of line and mock, in s, since each last received a line."""
        return (self.line.tell("").late_ns + self.mock.tell("").late_ns) * 1e-9

    def leave(self, driver: ScriptedDriver) -> None:
        """Silence a scripted driver and close its session."""
        self._scripted.remove(driver)
        driver.close()

    def ended(self, process: Process) -> None:
        """Stop a process and remove it from the rig."""
        process.stop()
        self.processes.remove(process)

    def close(self) -> None:
        """End everything, the last started first."""
        for driver in self._scripted:
            driver.close()
        for process in reversed(self.processes):
            process.send_signal(signal.SIGCONT)
            process.stop()
        if hasattr(self, "truth"):
            self.truth.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
