"""The file beside the bridge that keeps what was measured of robots without commands.

A measurement holds for one robot, by its address and namespace, and one description: both are its identity.
"""

import hashlib
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from datetime import UTC, datetime
from pathlib import Path

from pydantic import Field

from bridge.inbox import ThreadError
from bridge.ros_base.address import RosAddress
from bridge.ros_base.silence import NotStored, Silence
from rover_ncp.core.config import StrictModel, dump_yaml, load_yaml
from rover_ncp.core.errors import RoverNcpError
from rover_ncp.core.files import write_atomic
from rover_ncp.core.robot_description import RobotDescription


class _Entry(StrictModel):
    """One robot's result; ``timeout_s`` None = it did not halt."""

    robot: str
    model: str
    timeout_s: float | None = Field(ge=0)
    measured: datetime


class _Entries(StrictModel):
    format: int = 1
    robots: dict[str, _Entry] = Field(default_factory=dict)


class SilenceFile:
    """The file of one robot's results. Raises FileError or ConfigError for a file that cannot be read."""

    def __init__(self, path: Path | None, address: RosAddress, description: RobotDescription) -> None:
        state = os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state"
        self.path = path or Path(state) / "rover-ncp" / "robots.yaml"
        self._robot = f"{address.endpoint} {address.convention} {address.domain} {address.namespace}".strip()
        self._model = description.name
        identity = f"{self._robot}\n{description.model_dump_json()}"
        self._identity = hashlib.sha256(identity.encode()).hexdigest()[:16]
        self._writer = ThreadPoolExecutor(1)  # one thread: the last result stays

    def load(self, unsafe: bool) -> Silence:
        """Return what is known of the robot."""
        silence = Silence(unsafe=unsafe)
        if not self.path.exists():
            return silence
        entry = load_yaml(self.path, _Entries).robots.get(self._identity)
        return silence if entry is None else silence.measured(entry.timeout_s)

    def store(self, silence: Silence) -> None:
        """Keep a measurement, beside those of other robots."""
        entries = load_yaml(self.path, _Entries).robots if self.path.exists() else {}
        now = datetime.now(UTC).replace(microsecond=0)
        entry = _Entry(robot=self._robot, model=self._model, timeout_s=silence.timeout_s, measured=now)
        data = _Entries(robots={**entries, self._identity: entry}).model_dump(mode="json")
        write_atomic(self.path, dump_yaml(data))

    def store_in_background(self, report: Callable[[object], None], silence: Silence) -> None:
        """Store on another thread; ``report`` gets a `NotStored`, or a `ThreadError`."""

        def work() -> None:
            try:
                self.store(silence)
            except RoverNcpError as error:
                report(NotStored(str(error)))
            except Exception as error:
                report(ThreadError(error))

        self._writer.submit(work)
