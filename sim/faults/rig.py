"""Mock, bridge, links that can be spoilt and drivers as real processes, and how the rover truly moves.

The base's faults come by the mock's standard input, hangs from a wrapper around the command
(`sim.faults.hang`), mishaps of both links from proxies: no process under test has a hook for them.
"""

import signal
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from types import TracebackType
from typing import Self, TypeVar

from rover_ncp.core.errors import RoverNcpError
from sim.faults.proxy import Proxy
from sim.faults.scripted_driver import Hand
from sim.faults.standstill import Motion, TruthReader
from sim.live.processes import Process, compile_driver, uninterrupted

SPEED_M_S = 0.12
"""At which a steady hand drives."""
CREEP_M_S = 0.05
"""From this on a circuit's rover is under way."""
HANGABLE = "sim.faults.hang"

Kept = TypeVar("Kept", bound=Process)


class InVain(RoverNcpError):
    """What was waited for does not come."""

    exit_code = 1


class Unsafe(RoverNcpError):
    """The rover did what it must never do."""

    exit_code = 1


def wait_for(condition: Callable[[], bool], what: str, timeout_s: float = 8.0) -> None:
    """Wait until a condition holds. Raises InVain."""
    deadline = time.monotonic() + timeout_s
    while not condition():
        if time.monotonic() > deadline:
            raise InVain(f"waited {timeout_s:g} s in vain: {what}")
        time.sleep(0.01)


class Rig:
    """``robot`` is the bridge; ``spoilt`` leads there through ``link``; ``line`` from there to the base.

    ``course`` is what circuits drive; ``mock`` and ``bridge`` are more arguments for these; ``outlet`` is the
    kind of `Outlet` that takes the bridge's output.
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
        self._hands: list[Hand] = []
        self._deploys, self._bridge_arguments, self._outlet = 0, bridge, outlet
        truth = folder / "truth.csv"
        try:
            arguments = ["--listen", "127.0.0.1:0", "--truth", str(truth), "--fault", "-", *mock]
            self.mock = self._start(lambda: Process("mock", arguments, folder, told=True))
            base = self.mock.wait_for_line("listening on ")
            self.line = self._start(lambda: Proxy(base, folder, "line"))
            self.start_bridge("tcp/127.0.0.1:0")
            self.link = self._start(lambda: Proxy(self.robot.removeprefix("tcp/"), folder, "link"))
            self.spoilt = f"tcp/{self.link.address}"
            self.truth = TruthReader(truth)
            self.watcher = self.hand()
            """Hears everything, sends nothing."""
            self.watcher.silent, self.watcher.greedy = True, False
        except BaseException:
            self.close()
            raise

    def _start(self, start: Callable[[], Kept]) -> Kept:
        with uninterrupted():
            process = start()
            self.processes.append(process)
        return process

    def start_bridge(self, listen: str | None = None) -> None:
        """Start the bridge, again if it is dead; then it listens where it did."""
        arguments = ["--base", f"tcp/{self.line.address}", "--listen", listen or self.robot]
        arguments += self._bridge_arguments
        self.bridge = self._start(
            lambda: Process("bridge", arguments, self.folder, HANGABLE, outlet=self._outlet)
        )
        ready = dict(part.split("=", 1) for part in self.bridge.wait_for_line("ready ").split())
        self.robot = ready["zenoh"]

    def deploy(self, *options: str, robot: str | None = None) -> Process:
        """Start a driver: a circuit."""
        compile_driver()
        self._deploys += 1
        folder = self.folder / f"deploy{self._deploys}"
        folder.mkdir(exist_ok=True)
        arguments = ["--robot", robot or self.robot, "--course", str(self.course), *options]
        return self._start(lambda: Process("deploy", arguments, folder, HANGABLE))

    def hand(self, robot: str | None = None, lease_s: float = 1.0) -> Hand:
        """Start a driver of constant speed, in this process."""
        self._hands.append(Hand(robot or self.robot, lease_s))
        return self._hands[-1]

    def motion(self) -> Motion | None:
        """How the rover moves now; None before the mock has said so."""
        rows = self.truth.read()
        return rows[-1] if rows else None

    def speed(self) -> float:
        """Its speed now, in m/s."""
        motion = self.motion()
        return motion.v if motion else 0.0

    def under_way(self, hand: Hand, v: float = SPEED_M_S) -> Hand:
        """Let a hand drive, and wait until the rover does. Raises InVain."""
        hand.velocity = hand.velocity._replace(v=v)
        wait_for(lambda: abs(self.speed() - v) < 0.01, "the rover under a steady hand")
        return hand

    def driven(self, deploy: Process) -> None:
        """Wait until a circuit has the rover moving. Raises InVain or ProcessError."""
        wait_for(lambda: not deploy.running or abs(self.speed()) > CREEP_M_S, "the circuit to drive", 30.0)
        if not deploy.running:
            raise deploy.failure()

    def stood(self, since_ns: int, timeout_s: float = 6.0) -> float:
        """Wait until the rover stands; return how long after ``since_ns`` it came to, in s. Raises NotStill.

        ``since_ns`` is of the machine's monotonic clock, at which the mock keeps its simulation.
        """
        return self.truth.stood_after(since_ns, timeout_s)

    def late_s(self) -> float:
        """Return how late line and mock ran, at worst, since they were last given a line."""
        return (self.line.tell("").late_ns + self.mock.tell("").late_ns) * 1e-9

    def leave(self, hand: Hand) -> None:
        """Let a hand fall silent and go."""
        self._hands.remove(hand)
        hand.close()

    def ended(self, process: Process) -> None:
        """Forget a process that has ended."""
        process.stop()
        self.processes.remove(process)

    def close(self) -> None:
        """End everything, the last started first."""
        for hand in self._hands:
            hand.close()
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
