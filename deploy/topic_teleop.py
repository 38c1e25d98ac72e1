"""A ROS node drives: its commands on a topic in, signed commands out, through the same lease and gate.

Rules of this file:

1. The lease is requested only with a zero command `HOLD_S` after the last other one, or with the first
   command after a pause. So a publisher that never paused moves nothing after a start, a hazard or another
   driver.
2. Commands of one publisher count while the lease is held. A command is passed on once, when it arrives.
   `HOLD_S` after the last one the driver sends zeros, and after `PAUSE_S` it releases the lease.
3. The end of a lease is named in the log, and rule 1 holds again. The command ends with the bridge.
"""

import logging
import math
from collections.abc import Callable

from deploy.drive.link import Link, RosCommand
from deploy.drive.measurements import Measurements
from deploy.drive.safety_monitor import SafetyMonitor
from rover_ncp.core.console import printable
from rover_ncp.core.errors import AnotherDriver, FormatError, SafetyStop
from rover_ncp.core.geometry import STANDSTILL, Velocity
from rover_ncp.core.process import Clock
from rover_ncp.wire.messages import read_twist
from rover_ncp.wire.protocol import in_words

_LOGGER = logging.getLogger("rover_ncp")
PERIOD_S = 0.05
MAX_AGE_S = 0.3
"""A command whose stamp is farther from this computer's clock is dropped."""
HOLD_S, PAUSE_S = 0.3, 1.0
RETRY_S = 1.0
"""Shortest time between two requests for the motors."""


class TopicTeleop:
    """A ROS node's drives over an open link; ``seconds`` is for how long it held the lease.

    ``read`` returns the commands that arrived, and waits for the first at most a given time. ``begin`` is
    called when the first lease is granted.
    """

    def __init__(
        self,
        link: Link,
        read: Callable[[float], list[RosCommand]],
        interrupted: Callable[[], bool],
        clock: Clock,
        *,
        begin: Callable[[], None] = lambda: None,
    ) -> None:
        self._link, self._read, self._interrupted, self._clock = link, read, interrupted, clock
        self._begin = begin
        self._measurements = Measurements(link)
        self._monitor: SafetyMonitor | None = None
        """Of the lease that is held."""
        self._source, self._sent = "", STANDSTILL
        self._moved_s = clock.monotonic()
        """When a command that was not zero came last, whether it counted or not."""
        self._came_s = self._due_s = self._asked_s = self._granted_s = -math.inf
        self._named = set[str]()
        self.seconds = 0.0

    @property
    def progress(self) -> str:
        """One line for people; another thread may read it."""
        v, omega = self._sent
        held = f"  held by {in_words(self._link.gate.held)}" if self._link.gate.held else ""
        return printable(f"{v:+.2f} m/s  {omega:+.2f} rad/s{held}")

    def wait(self) -> None:
        """Wait for bridge, permission and odometry. Raises as `SafetyMonitor.wait`."""
        self._new_monitor().wait()

    def run(self) -> None:
        """Pass commands on for good. Raises KeyboardInterrupt, SafetyStop or UnreachableError.

        The rover was stopped then.
        """
        self._moved_s = self._clock.monotonic()
        try:
            while True:
                self._turn(self._read(PERIOD_S))
        finally:
            self._release()

    def _turn(self, commands: list[RosCommand]) -> None:
        if self._interrupted():
            raise KeyboardInterrupt
        if not self._link.bridge_alive:
            raise SafetyStop("bridge-lost", "the bridge is gone")
        self._measurements.odometry(0)  # the safety monitor judges the newest
        try:
            if self._monitor is not None:
                self._monitor.check()
            for command in commands:
                self._take(command)
            self._go_on()
        except SafetyStop as stop:
            self._release()
            self._name(f"the rover is not driven: {stop}", stop.rule)

    def _take(self, command: RosCommand) -> None:
        now = self._clock.monotonic()
        velocity, age_s = self._read_velocity(command, now)
        # Two nodes behind one bridge of ROS 2 look like one: a zero of one is no pause of the other.
        paused = now - self._moved_s >= (HOLD_S if velocity == STANDSTILL else PAUSE_S)
        if velocity != STANDSTILL:
            self._moved_s = now
        if self._monitor is None:
            asks = velocity is not None and paused and now - self._asked_s >= RETRY_S
            if not asks or not self._request(command.source):
                return
        if command.source != self._source:
            self._name("another node publishes commands on the topic too: they are not passed on", "two")
        elif velocity is None:
            self._send(STANDSTILL)
        else:
            self._came_s = now - age_s
            self._send(velocity)

    def _read_velocity(self, command: RosCommand, now: float) -> tuple[Velocity | None, float]:
        """Return the velocity of a command, None if it is not fresh, finite and readable, and its age."""
        age_s = now - command.arrived_s
        try:
            velocity, stamp_ns = read_twist(command.data)
        except FormatError as error:
            self._name(f"a command cannot be read: {error}", "unreadable")
            return None, age_s
        sent_ns = command.stamp_ns if stamp_ns is None else stamp_ns
        stamped_s = 0.0 if sent_ns is None else (self._clock.time_ns() - sent_ns) * 1e-9
        age_s = max(age_s, stamped_s)
        if stamped_s < -MAX_AGE_S:
            words = f"a command is stamped {-stamped_s:.1f} s after its arrival: synchronise the clocks"
            self._name(words, "early")
        elif age_s > MAX_AGE_S:
            words = f"a command is {age_s:.1f} s old: the link is slow, or the clocks are not synchronised"
            self._name(words, "stale")
        elif not all(map(math.isfinite, velocity)):
            self._name("a command is not finite", "not-finite")
        else:
            return velocity, age_s
        return None, age_s

    def _request(self, source: str) -> bool:
        """Request the lease for a publisher's commands, and return whether it was granted."""
        self._asked_s = self._clock.monotonic()
        if self._measurements.newest is None:
            return False
        monitor = self._new_monitor()
        try:
            self._link.request_motors("teleop")
        except AnotherDriver as error:
            self._name(str(error), "another-driver")
            return False
        monitor.granted()
        if self._granted_s == -math.inf:
            self._begin()
        self._monitor, self._source, self._granted_s = monitor, source, self._clock.monotonic()
        self._named.clear()
        return True

    def _go_on(self) -> None:
        """Send zeros after the last command, and release the lease after a pause."""
        now = self._clock.monotonic()
        if self._monitor is None:
            return
        if now - self._came_s >= PAUSE_S:
            self._release()
        elif now - self._came_s >= HOLD_S and now >= self._due_s:
            self._send(STANDSTILL)

    def _send(self, velocity: Velocity) -> None:
        if self._monitor is not None:
            self._sent, self._due_s = velocity, self._clock.monotonic() + PERIOD_S
            self._link.command(velocity)

    def _release(self) -> None:
        if self._monitor is not None:
            self.seconds += self._clock.monotonic() - self._granted_s
        self._monitor, self._sent = None, STANDSTILL
        self._link.release()

    def _new_monitor(self) -> SafetyMonitor:
        return SafetyMonitor(self._link, self._measurements, self._interrupted, clock=self._clock)

    def _name(self, words: str, kind: str) -> None:
        """Log a line once for each lease and kind."""
        if kind not in self._named:
            _LOGGER.info(words)
            self._named.add(kind)
