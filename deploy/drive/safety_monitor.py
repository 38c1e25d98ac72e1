"""Safety checks of a driver: the conditions to start, and the checks before each command.

A check that fails raises SafetyStop with the name of its rule. A termination signal raises KeyboardInterrupt.
"""

import math
import time
from collections import deque
from collections.abc import Callable
from typing import NamedTuple

from pydantic import Field

from deploy.drive.link import Bumpers, Link
from deploy.drive.measurements import Measurements
from rover_ncp.core.clock_offset import NS_PER_S
from rover_ncp.core.config import StrictModel
from rover_ncp.core.errors import NoBridge, NoRobot, NotAuthorised, SafetyStop
from rover_ncp.core.geometry import Velocity
from rover_ncp.core.process import Clock
from rover_ncp.course.course import TICK_S
from rover_ncp.wire.protocol import REASONS, UNNAMED, GateStatus, in_words

POLL_S = 0.002

PAUSE_S = 0.15
"""A longer time between two checks is a stall of the driver, which waits for 0.05 s at most."""
WINDOW_TICKS = round(1.0 / TICK_S)
LAG_TICKS = round(0.7 / TICK_S)
SHORTEST_LAG_TICKS = round(0.1 / TICK_S)
COMMANDED_MIN_M = 0.05
COMMANDED_MIN_RAD = 0.10
"""Commanded motion within the window below these may be lost in the base's whole mm/s and deg/s."""
FOLLOWED_MIN = 0.1
"""The share of the commanded motion that the rover must have driven."""


class Timeouts(StrictModel):
    """Times in s."""

    bridge_wait_s: float = Field(default=5.0, gt=0, description="for the bridge's liveliness token")
    permission_wait_s: float = Field(default=2.0, gt=0, description="for the bridge's subscription")
    odometry_wait_s: float = Field(default=5.0, gt=0, description="for the first odometry")
    odometry_age_s: float = Field(default=0.4, gt=0, le=0.5, description="older odometry stops the rover")
    lease_wait_s: float = Field(default=1.0, gt=0, description="for the gate to confirm our lease")


class SafetyMonitor:
    """Checks bridge, permission, odometry, lease and the rover's response for one driver."""

    def __init__(
        self,
        link: Link,
        measurements: Measurements,
        interrupted: Callable[[], bool],
        timeouts: Timeouts | None = None,
        clock: Clock = time,
    ) -> None:
        self._link, self._measurements = link, measurements
        self._interrupted, self._clock = interrupted, clock
        self._timeouts = timeouts or Timeouts()
        self._granted_ns: int | None = None
        self._granted_gate, self._granted_bumped = GateStatus(), Bumpers().times
        self.contact = ""
        """The contact that the base reported since the lease was granted, in words."""
        self._confirmed: int | None = None
        """Number of the newest lease that the gate confirmed."""
        self._response, self._odometry_response = ResponseCheck(), ResponseCheck()
        self._checked_ns: int | None = None
        self._pause_s, self._pause_odometry = 0.0, measurements.newest
        """The longest time between two checks since the newest odometry."""

    def wait(self, *, drives: bool = True) -> None:
        """Wait for bridge, permission (if it ``drives``) and odometry.

        Raises NoBridge, NotAuthorised, NoRobot or KeyboardInterrupt.
        """
        self.wait_for_bridge()
        link, timeouts = self._link, self._timeouts
        if drives and not self.until(link.authorised, timeouts.permission_wait_s):
            raise NotAuthorised(f"not authorised: the bridge at {link.robot} does not take commands from us")
        if not self.until(lambda: self._measurements.odometry(0) is not None, timeouts.odometry_wait_s):
            raise NoRobot(f"the bridge at {link.robot} sends no odometry: {self.why_no_odometry()}")

    def why_no_odometry(self) -> str:
        """Return what is known of the cause when no odometry arrives that can be used."""
        measurements, base = self._measurements, self._link.about_base()
        if complaint := measurements.complaints.get("odom"):
            return f"its messages cannot be read: {complaint}"
        if base is None:
            return "it does not answer on rover/base either"
        if base.problem:
            return f"it reports that {base.problem}"
        if count := measurements.doubtful["odom"]:
            return f"the stamps of {count} messages do not fit the times of their arrival"
        return f"it reports the base {base.model or 'as not connected yet'}; see the bridge's log"

    def wait_for_bridge(self) -> None:
        """Wait for the bridge's liveliness token. Raises NoBridge or KeyboardInterrupt."""
        link, wait_s = self._link, self._timeouts.bridge_wait_s
        if not self.until(lambda: link.bridge_alive, wait_s):
            raise NoBridge(
                f"something answers at {link.robot}, but no bridge is announced there{link.where} "
                f"within {wait_s:g} s{self._bridges()}"
            )

    def _bridges(self) -> str:
        """Return the namespaces in which bridges are announced, in words; "" if there are none."""
        found = [where or "no namespace" for where in self._link.bridges()]
        return f"; bridges are announced in: {', '.join(found)} (--namespace)" if found else ""

    def until(
        self,
        condition: Callable[[], bool],
        timeout_s: float,
        wait: Callable[[float], object] | None = None,
    ) -> bool:
        """Wait for a condition; return False if it did not hold in time. Raises KeyboardInterrupt.

        ``wait`` lets at most so many seconds pass until the condition is looked at again; without it the
        driver sleeps for `POLL_S`.
        """
        deadline = self._clock.monotonic() + timeout_s
        while not condition():
            if self._interrupted():
                raise KeyboardInterrupt
            if (left_s := deadline - self._clock.monotonic()) < 0.0:
                return False
            if wait is None:
                self._clock.sleep(POLL_S)
            else:
                wait(max(left_s, POLL_S))
        return True

    def granted(self) -> None:
        """Note that the lease is ours from now on; the gate has a limited time to confirm it."""
        self._granted_ns = self._checked_ns = self._clock.monotonic_ns()
        self._granted_gate, self._granted_bumped = self._link.gate, self._link.bumpers.times

    def bumped(self, end: int) -> bool:
        """Return whether the bumper of an end (0 front, 1 rear) was pressed since the lease was granted."""
        return self._link.bumpers.times[end] > self._granted_bumped[end]

    def check(self) -> None:
        """Check bridge, age of odometry and lease. Raises SafetyStop or KeyboardInterrupt."""
        if self._interrupted():
            raise KeyboardInterrupt
        if not self._link.bridge_alive:
            raise SafetyStop("bridge-lost", "the bridge is gone")
        assert self._measurements.newest is not None  # `wait` was called
        now_ns, newest = self._clock.monotonic_ns(), self._measurements.newest
        self._note_pause(now_ns)
        limit_s = self._timeouts.odometry_age_s
        # Fresh odometry after a stall does not count: the last command was computed before the stall.
        age_s = max((now_ns - newest.ref.measured_ns) / NS_PER_S, self._pause_s)
        if age_s > limit_s:
            words = f"odometry is {age_s:.2f} s old (limit {limit_s} s)"
            if self._pause_s > PAUSE_S:
                words += f"; the driver process was stalled for {self._pause_s:.2f} s"
            raise SafetyStop("odometry-age", words)
        if self._granted_ns is not None:
            self._check_lease(self._granted_ns)

    def _note_pause(self, now_ns: int) -> None:
        pause_s = 0.0 if self._checked_ns is None else (now_ns - self._checked_ns) / NS_PER_S
        if self._pause_odometry is not self._measurements.newest:
            self._pause_s, self._pause_odometry = 0.0, self._measurements.newest
        self._checked_ns, self._pause_s = now_ns, max(self._pause_s, pause_s)

    def _check_lease(self, granted_ns: int) -> None:
        gate, lease, now_ns = self._link.gate, self._link.lease, self._clock.monotonic_ns()
        if gate.lease == lease.number:
            self._confirmed = lease.number
            bumped = REASONS["bumper"] if self.bumped(0) or self.bumped(1) else ""
            self.contact = self.contact or gate.contact_since(self._granted_gate) or bumped
        elif self._confirmed == lease.number:
            raise revoked(gate)
        elif now_ns - granted_ns > self._timeouts.lease_wait_s * NS_PER_S:
            raise SafetyStop("lease", "the gate does not confirm the lease")
        lease.check(gate, now_ns)

    def check_command(self, command: Velocity, motion: Velocity) -> None:
        """Check one tick's command, and that the rover follows earlier ones. Raises SafetyStop.

        ``motion`` is the estimated motion before this command.
        """
        if not all(map(math.isfinite, command)):
            raise SafetyStop("command", f"the circuit's command is not finite: {command}")
        missing = self._response.tick(command, motion)
        assert self._measurements.newest is not None  # `wait` was called
        by_odometry = self._odometry_response.tick(command, self._measurements.newest.sample.velocity)
        if missing and missing.unit == "rad" and not by_odometry and self._measurements.taken["imu"]:
            words = "odometry shows more: the gyro is wrong, or the wheels spin"
            raise SafetyStop("gyro", f"by the estimate the rover drove {missing}, and {words}")
        if missing:
            gate = self._link.gate
            held = f" (the gate reports {in_words(gate.held, gate.held_detail)})" if gate.held else ""
            raise SafetyStop("no-response", f"by the estimate the rover drove {missing}{held}")


def revoked(gate: GateStatus) -> SafetyStop:
    """Return the stop of a driver whose lease the gate revoked; it names who did and why."""
    if gate.ended == "stopped":
        return SafetyStop(gate.ended, by=gate.ended_detail or UNNAMED)
    return SafetyStop(gate.ended or "lease", gate.ended_detail or "the gate revoked the lease")


class Missing(NamedTuple):
    """Motion of a second that is missing: what was driven and what was commanded, in m or rad."""

    driven: float
    commanded: float
    unit: str

    def __str__(self) -> str:
        driven, commanded = f"{self.driven:.3f} {self.unit}", f"{self.commanded:.3f} {self.unit}"
        return f"{driven} where {commanded} were commanded within a second"


class ResponseCheck:
    """Compares each tick's command with the estimated motion.

    It detects frozen odometry, blocked wheels and a hold of the gate. It covers a second of commands, after
    the base's delay and acceleration: 0.7 s, or 0.1 s. Only motion that was commanded in both windows counts,
    because a short burst of commands may be over before the later one begins.
    """

    def __init__(self) -> None:
        self._commanded: deque[Velocity] = deque(maxlen=WINDOW_TICKS + LAG_TICKS)
        self._driven: deque[Velocity] = deque(maxlen=WINDOW_TICKS)

    def tick(self, command: Velocity, motion: Velocity) -> Missing | None:
        """Return the motion that is missing, if any is. ``motion`` was measured before this command."""
        self._driven.append(motion)
        missing = None
        if len(self._commanded) == self._commanded.maxlen:
            commands, latest = list(self._commanded), LAG_TICKS - SHORTEST_LAG_TICKS
            windows = commands[:WINDOW_TICKS], commands[latest : latest + WINDOW_TICKS]
            for axis, unit, minimum in ((0, "m", COMMANDED_MIN_M), (1, "rad", COMMANDED_MIN_RAD)):
                # Commands to and fro may cancel out; motion either way shows that something is followed.
                wanted = TICK_S * min(abs(sum(command[axis] for command in window)) for window in windows)
                got = TICK_S * sum(abs(motion[axis]) for motion in self._driven)
                if wanted >= minimum and got < FOLLOWED_MIN * wanted:
                    missing = Missing(got, wanted, unit)
        self._commanded.append(command)
        return missing
