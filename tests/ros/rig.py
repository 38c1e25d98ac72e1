"""Real ROS 2 beside the project: processes of the ROS environment, and the bridge and drivers of ours."""

import itertools
import json
import os
import shutil
import subprocess
from contextlib import suppress
from pathlib import Path

from kit.zenoh_session import open_router

from rover_ncp.core.process import ClosedAtExit
from sim.mock.ros2_server import free_port
from sim.park.live import RMW_ZENOH, ROS2DDS, GrowingFile, LiveRun, ProcessError, wait_for

FOLDER = Path(__file__).parent
VENV = FOLDER.parents[1] / "build" / "venv-ros"
PYTHON = VENV / "bin" / "python"
ROS2DDS_BRIDGE = shutil.which("zenoh-bridge-ros2dds")
"""The real one, which is used where it is present; else the stand-in."""
STARTED_S = 30.0
TOPICS = 4
MODEL = str(Path(__file__).with_name("robot.yaml"))
"""The description of `robot.py`."""
# Each worker of xdist has 30 domains. Those above 101 have ports that Linux gives to others.
_FIRST = 1 + 30 * int(os.environ.get("PYTEST_XDIST_WORKER", "gw0")[2:])
_domains = itertools.cycle(range(_FIRST, _FIRST + 30))


def ros_environment(domain):
    """Return the environment of a ROS process, which finds others of its domain on this machine only."""
    ours = ("PATH", "HOME", "LANG", "TMPDIR")
    return {name: os.environ[name] for name in ours if name in os.environ} | {
        "ROS_DOMAIN_ID": str(domain),
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
        "RMW_IMPLEMENTATION": "rmw_fastrtps_cpp",
        "ROS_DISTRO": "kilted",  # by which zenoh-bridge-ros2dds knows the form of ROS's discovery messages
        "FASTDDS_BUILTIN_TRANSPORTS": "UDPv4",  # shared memory outlives processes that are killed
        "OPENBLAS_NUM_THREADS": "1",
        "CYDR_CACHE_DIR": str(VENV / "cydr"),
    }


class RosProcess(ClosedAtExit):
    """A script of this folder, or a program, in the ROS environment. Its output goes to a file."""

    def __init__(self, name, command, folder, domain):
        self.name, log = name, folder / f"{name}.log"
        self._script = command[0].endswith(".py")
        run = [str(PYTHON), str(FOLDER / command[0])] if self._script else command[:1]
        with log.open("wb") as out:
            self._child = subprocess.Popen(
                [*run, *map(str, command[1:])],
                stdin=subprocess.PIPE,
                stdout=out,
                stderr=subprocess.STDOUT,
                env=ros_environment(domain) | {"ROS_LOG_DIR": str(folder)},
                start_new_session=True,
            )
        self._file, self.lines = GrowingFile(log), []

    def read(self):
        """Return all lines so far. Raises ProcessError if it failed."""
        self.lines += self._file.new_lines()
        if self._child.poll():
            raise ProcessError(self.name, self._child.returncode, "\n".join(self.lines[-20:]))
        return self.lines

    def announced(self):
        """Return the topics of DDS that the relay has announced on Zenoh."""
        return {line for line in self.read() if line.startswith("announced")}

    def objects(self):
        """Return the JSON objects that it printed."""
        return [json.loads(line) for line in self.read() if line.startswith("{")]

    @property
    def last(self):
        return wait_for(self.objects, STARTED_S, f"JSON from {self.name}")[-1]

    def wait_for_line(self, start):
        return wait_for(
            lambda: [line for line in self.read() if line.startswith(start)],
            STARTED_S,
            f"{start} {self.name}",
        )

    def stop(self):
        """End it: our scripts when their input ends, programs by SIGTERM."""
        with suppress(BrokenPipeError):
            self._child.stdin.close()
        if not self._script:
            self._child.terminate()
        try:
            self._child.wait(5.0)
        except subprocess.TimeoutExpired:
            self._child.kill()
            self._child.wait()

    close = stop


def free_address():
    """Return HOST:PORT where nothing listens now."""
    return f"127.0.0.1:{free_port('127.0.0.1')}"


class RunWithRos(LiveRun):
    """A run with ROS processes, which have a ``ROS_DOMAIN_ID`` that no other test has now."""

    def __init__(self, *arguments, **options):
        super().__init__(*arguments, **options)
        self.domain, self.relay = next(_domains), None

    def ros(self, name, *command):
        """Start a ROS process that ends with the run."""
        return self.start_process(lambda: RosProcess(name, command, self.folder, self.domain))

    def start_relay(self, address, *arguments):
        """Start zenoh-bridge-ros2dds, or the stand-in, which listens on ``address``."""
        arguments = ["-l", f"tcp/{address}", *arguments]
        if ROS2DDS_BRIDGE:
            return self.ros("ros2dds", ROS2DDS_BRIDGE, *arguments)
        self.relay = self.ros("ros2dds", "relay.py", *arguments)
        self.relay.wait_for_line("ready")
        return self.relay


class RosRun(RunWithRos):
    """A robot of ROS 2, its Zenoh integration, and our bridge; ``way`` is a wire of ``wires.py``."""

    def __init__(self, folder, *bridge, model=MODEL, robot=(), way="rclpy", namespace=""):
        super().__init__(folder, bridge=["--model", model, "--no-base-watchdog", *bridge])
        self.way = way
        self._base_form = f"{ROS2DDS}#" if way == "rclpy" else f"{RMW_ZENOH}&domain={self.domain}"
        self._base_form += f"&namespace={namespace}" if namespace else ""
        self._robot_arguments = ["--by", way, "--namespace", namespace, *robot]
        self._router = None

    def start_mock(self):
        """Start the robot and its Zenoh router; return the router's address."""
        if self.way == "rclpy":
            self.base = free_address()
            self.start_relay(self.base)
        else:  # any router does what rmw_zenohd does for nodes of one machine
            self._router, locator = open_router()
            self.base = locator.removeprefix("tcp/")
        address = ["--router", self.base]
        self.body = self.ros("robot", "robot.py", *self._robot_arguments, *address)
        self.body.wait_for_line("{")
        if self.relay is not None:
            # A route has the type that is seen first: else it could be that of our bridge.
            wait_for(
                lambda: len(self.relay.announced()) >= TOPICS, STARTED_S, "the robot's topics in the relay"
            )
        return self.base

    def close(self):
        super().close()
        if self._router is not None:
            self._router.close()
