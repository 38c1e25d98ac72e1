"""Safety checks of a driver: the conditions to start, and the checks before each command."""

import time
from collections.abc import Callable

from deploy.drive.clock import NS
from deploy.drive.link import Link
from deploy.drive.measurements import Intake
from deploy.drive.waits import Waits
from rover_ncp.core.errors import NoBridge, NoRobot, NotAuthorised, SafetyStop
from rover_ncp.core.process import Clock

POLL_S = 0.002


class Interrupted(Exception):
    """A termination signal was received."""


class Guard:
    """Bridge, permission, odometry and lease of one driver."""

    def __init__(
        self, link: Link, intake: Intake, waits: Waits, interrupted: Callable[[], bool], clock: Clock = time
    ) -> None:
        self._link, self._intake, self._waits = link, intake, waits
        self._interrupted, self._clock = interrupted, clock
        self._granted_ns: int | None = None
        self._lease_seen = False

    def wait(self, drives: bool, namespace: str) -> None:
        """Wait for bridge, permission (if it ``drives``) and odometry.

        Raises NoBridge, NotAuthorised, NoRobot or Interrupted.
        """
        link, waits = self._link, self._waits
        if not self.until(lambda: link.bridge_alive, waits.bridge_wait_s):
            where = f" in namespace {namespace}" if namespace else ""
            raise NoBridge(
                f"something answers at {link.robot}, but no bridge shows itself there{where} "
                f"within {waits.bridge_wait_s:g} s"
            )
        if drives and not self.until(link.authorised, waits.permission_wait_s):
            raise NotAuthorised(f"not authorised: the bridge at {link.robot} does not take commands from us")
        if not self.until(lambda: self._intake.take(0) is not None, waits.odometry_wait_s):
            raise NoRobot(f"the bridge at {link.robot} sends no odometry: is its base connected?")

    def granted(self) -> None:
        """Note that the lease is ours from now on; the gate has a limited time to confirm it."""
        self._granted_ns = self._clock.monotonic_ns()

    def check(self) -> None:
        """Raise SafetyStop if a safety rule is broken, Interrupted if a termination signal was received."""
        if self._interrupted():
            raise Interrupted
        if not self._link.bridge_alive:
            raise SafetyStop("bridge-lost", "the bridge is gone")
        assert self._intake.newest is not None
        age_s = (self._clock.monotonic_ns() - self._intake.newest.ref.measured_ns) / NS
        if age_s > self._waits.odometry_age_s:
            limit = self._waits.odometry_age_s
            raise SafetyStop("odometry-age", f"the newest odometry is {age_s:.2f} s old (at most {limit} s)")
        if self._granted_ns is not None:
            self._check_lease(self._granted_ns)

    def _check_lease(self, granted_ns: int) -> None:
        gate = self._link.gate
        if gate.lease == self._link.lease.number:
            self._lease_seen = True
        elif self._lease_seen:
            raise SafetyStop(gate.ended or "lease", "the gate revoked the lease")
        elif self._clock.monotonic_ns() - granted_ns > self._waits.lease_wait_s * NS:
            raise SafetyStop("lease", "the gate does not confirm the lease")
        self._link.lease.check(gate, self._clock.monotonic_ns())

    def until(self, condition: Callable[[], bool], timeout_s: float) -> bool:
        """Wait for a condition; False if it did not come in time. Raises Interrupted."""
        deadline = self._clock.monotonic() + timeout_s
        while not condition():
            if self._interrupted():
                raise Interrupted
            if self._clock.monotonic() > deadline:
                return False
            self._clock.sleep(POLL_S)
        return True
