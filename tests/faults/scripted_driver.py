"""Scripted driver: drives at constant speed, and can send the messages of a hostile or broken driver.

It uses the protocol of ``rover-ncp deploy``. Without a lease it requests one again, and it sends commands in
every state of the gate. So the gate stops the rover, never the driver.
"""

import threading
import time
from contextlib import suppress
from typing import Self

from kit.bridge_bench import PERIOD_S, Driver

from rover_ncp.core.errors import FormatError
from rover_ncp.core.geometry import Velocity
from rover_ncp.wire.messages import twist_stamped

REQUEST_S = 0.25
NAME = "hand"
"""The driver's name in the gate's status."""


class ScriptedDriver(Driver):
    """Drives at ``velocity``; ``lease_s`` is the Zenoh lease, the time for which the link may be silent."""

    keys = ("odom", "rover/gate")
    name = NAME

    def __init__(self, robot: str, lease_s: float = 1.0) -> None:
        self.velocity = Velocity(0.0, 0.0)
        self.payload: bytes | None = None
        """Sent instead of the velocity, if not None."""
        self.requests_lease = True
        """Whether it requests the lease when it has none."""
        self.silent = False
        self.age_s = 0.0
        """How much older each command's stamp is than its true time, in s."""
        self.last_sent_ns = 0
        """When the last command was sent, in ns of the monotonic clock."""
        self._requested_s = 0.0
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._run, name=NAME, daemon=True)
        super().__init__(robot, lease_s=lease_s)

    def start(self) -> Self:
        """Start the thread."""
        self._thread.start()
        return self

    def close(self) -> None:
        """End the thread and the session, without releasing the lease."""
        self._closing.set()
        self._thread.join()
        super().close()

    @property
    def driving(self) -> bool:
        """Whether the gate granted the lease to this driver."""
        return 0 < self.lease.number == self.gate.lease

    def stop(self, release: bool = False) -> bool:
        """Request a stop, or its release; return whether the bridge answers."""
        with suppress(FormatError):
            super().stop(release)
            return True
        return False

    def query(self, name: str, payload: bytes, attachment: bytes | None = None) -> bytes:
        """Return the answer. A request for the lease must not delay commands for long."""
        return super().query(name, payload, attachment, 2.0 if name == "rover/stop" else 0.5)

    def receive(self, name: str, data: bytes) -> None:
        """Store a message that can be read."""
        with suppress(FormatError):
            super().receive(name, data)

    def _run(self) -> None:
        while not self._closing.wait(PERIOD_S):
            now = time.monotonic()
            if self.requests_lease and not self.driving and now - self._requested_s > REQUEST_S:
                self._requested_s = now
                with suppress(FormatError):
                    self.motors()
            if not self.silent:
                self.last_sent_ns = time.monotonic_ns()
                self.put(self.payload or twist_stamped(self.velocity, time.time_ns()), self.age_s)
