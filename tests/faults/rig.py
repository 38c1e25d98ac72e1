"""Mock, bridge, proxied links and drivers as real processes, and the rover's true motion.

The mock reads the base's faults from its standard input. A wrapper around the command causes hangs
(`hang.py`), and proxies cause the faults of both links. No process under test has a hook for them.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from kit.true_motion import speed, stood_after

from faults import hang
from faults.outlet import OutletProcess
from faults.proxy import Proxy
from faults.scripted_driver import ScriptedDriver
from rover_ncp.core.errors import RoverNcpError
from rover_ncp.core.files import DEFAULT_ROBOT
from rover_ncp.robot.description import load_description
from sim.park.live import PIONEER, READY_TIMEOUT_S, RMW_ZENOH, LiveRun, Process, wait_for

SPEED_M_S = 0.12
"""Speed of a scripted driver."""
CREEP_M_S = 0.05
"""Speed above which the rover of a circuit counts as moving."""
STAND_TIMEOUT_S = 8.0


class Unsafe(RoverNcpError):
    """The rover violated a safety requirement."""

    exit_code = 1


class Rig(LiveRun):
    """A live run with two proxies and scripted drivers.

    ``robot`` is the bridge's address; ``through_proxy`` is its address by way of the proxy ``link``. The
    bridge reaches the base through the proxy ``line``. ``course`` is the course of circuits. ``model`` is the
    robot's, which speaks ROS 2 unless ``base_form`` is that of a Pioneer. ``outlet`` is the kind of `Outlet`
    that takes the bridge's output.
    """

    module = hang.__file__

    def __init__(
        self,
        folder: Path,
        course: Path,
        *,
        mock: Sequence[str] = (),
        bridge: Sequence[str] = (),
        outlet: str = "",
        base_form: str = PIONEER,
        model: str = DEFAULT_ROBOT,
    ) -> None:
        self.description = load_description(model)
        if base_form != PIONEER:
            form = "rmw-zenoh" if base_form == RMW_ZENOH else "ros2dds"
            mock = ["--ros2", "--model", model, "--ros", form, *mock]
            bridge = ["--model", model, *bridge]
        super().__init__(folder, mock=mock, bridge=bridge, base_form=base_form)
        self.course, self._outlet = course, outlet
        self._scripted: list[ScriptedDriver] = []

    def start(self) -> None:
        """Start mock, bridge and proxies. Raises ProcessError or TimedOut."""
        super().start()
        self.link = self.start_process(lambda: Proxy(self.robot.removeprefix("tcp/"), self.folder, "link"))
        self.through_proxy = f"tcp/{self.link.address}"
        self.watcher = self.scripted_driver()
        """A driver that receives everything and sends nothing."""
        self.watcher.silent, self.watcher.requests_lease = True, False

    def start_mock(self) -> str:
        """Start the mock and the proxy ``line`` to it; return the proxy's address."""
        base = super().start_mock()
        self.line = self.start_process(lambda: Proxy(base, self.folder, "line"))
        return self.line.address

    def bridge_process(self, arguments: Sequence[str]) -> Process:
        """Return the bridge's process, with an outlet if the rig has one."""
        if self._outlet:
            return OutletProcess(self._outlet, "bridge", arguments, self.folder, self.module)
        return super().bridge_process(arguments)

    def drive_course(self, *options: str, robot: str = "") -> Process:
        """Start a driver with a circuit on the rig's course."""
        return self.deploy("--course", str(self.course), *options, robot=robot)

    def scripted_driver(self, robot: str = "", lease_s: float = 1.0) -> ScriptedDriver:
        """Start a scripted driver, in this process."""
        self._scripted.append(ScriptedDriver(robot or self.robot, lease_s).start())
        return self._scripted[-1]

    def under_way(self, driver: ScriptedDriver, v: float = SPEED_M_S) -> ScriptedDriver:
        """Let a scripted driver drive, and wait until the rover does. Raises TimedOut."""
        driver.velocity = driver.velocity._replace(v=v)
        wait_for(lambda: abs(speed(self.truth) - v) < 0.01, what="the rover under a scripted driver")
        return driver

    def driven(self, deploy: Process) -> None:
        """Wait until a circuit moves the rover. Raises TimedOut or ProcessError."""
        wait_for(
            lambda: not deploy.running or abs(speed(self.truth)) > CREEP_M_S,
            READY_TIMEOUT_S,
            "the circuit to drive",
        )
        if not deploy.running:
            raise deploy.failure()

    def stood(self, since_ns: int) -> float:
        """Return the time in s from ``since_ns`` (machine's monotonic clock) to the rover's stop.

        Raises TimedOut.
        """
        return stood_after(self.truth, since_ns, STAND_TIMEOUT_S)

    def late_s(self) -> float:
        """Return the greatest delay of line and mock, in s, since each last received a line."""
        return (self.line.tell("").late_ns + self.mock.tell("").late_ns) * 1e-9

    def heard_after_s(self, since_ns: int) -> float:
        """Return how long after ``since_ns`` (machine's monotonic clock) the base still received anything."""
        return max(self.mock.tell("").heard_ns - since_ns, 0) * 1e-9

    def end(self, driver: ScriptedDriver | Process) -> None:
        """End a driver."""
        if isinstance(driver, Process):
            driver.stop()
        else:
            self._scripted.remove(driver)
            driver.close()

    def close(self) -> None:
        """End all drivers, then all processes."""
        for driver in self._scripted:
            driver.close()
        super().close()


@dataclass
class Scene:
    """A rig and its driver: a scripted driver, or the process of a circuit."""

    rig: Rig
    driver: ScriptedDriver | Process
    note: str = ""
    """A property of this injection, if injections differ."""

    @property
    def scripted(self) -> ScriptedDriver:
        """The driver, which must be a scripted one."""
        assert isinstance(self.driver, ScriptedDriver)
        return self.driver

    @property
    def process(self) -> Process:
        """The driver, which must be a process."""
        assert isinstance(self.driver, Process)
        return self.driver

    def request_no_lease(self) -> None:
        """Stop a scripted driver from requesting the lease."""
        if isinstance(self.driver, ScriptedDriver):
            self.driver.requests_lease = False

    def dropped(self) -> int:
        """Return how many commands the gate has dropped."""
        return sum(self.scripted.gate.dropped.values())
