"""A run of real processes on this machine: mock Pioneer, bridge and driver, over loopback TCP and Zenoh.

Each process is the command that a user would type. Leaving the ``with`` block ends all of them.
"""

from collections.abc import Callable, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Self, TypeVar

from rover_ncp.core.process import ClosedAtExit
from sim.live.processes import Process, compile_driver, uninterrupted
from sim.live.truth import TRUTH, TruthReader

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
        compile_driver()
        self._deploys += 1
        # Several drivers may run at once, and each has its log.
        folder = self.folder / f"deploy-{self._deploys}" if self._deploys > 1 else self.folder
        folder.mkdir(exist_ok=True)
        arguments = ("--robot", robot or self.robot, *arguments)
        return self.start_process(lambda: Process("deploy", arguments, folder, self.module))

    def start_process(self, start: Callable[[], Started]) -> Started:
        """Start a process that ends with the run."""
        with uninterrupted():
            process = start()
            self.processes.append(process)
        return process

    def end_process(self, process: Process) -> None:
        """End a process before the others."""
        process.stop()
        self.processes.remove(process)

    def close(self) -> None:
        """End all processes, the last started first: a driver releases its lease while the bridge runs."""
        with uninterrupted(), ExitStack() as ending:
            for process in self.processes:
                ending.callback(process.stop)
