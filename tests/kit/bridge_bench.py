"""A mock Pioneer and a bridge as real processes, and a scripted driver."""

import time

import zenoh

from kit.driver_client import PERIOD_S, DriverClient  # noqa: F401  # the period is for the users of `Driver`
from rover_ncp.core.errors import FormatError
from rover_ncp.core.process import ClosedAtExit
from rover_ncp.wire.zenoh import client_config
from sim.park.live import wait_for

STOP_S = 0.5
"""Requirement 1: the rover stands so long after the last command, plus braking."""
BRAKING_M_S2, DELAY_S = 0.31, 0.15
MACHINE_S = 0.1
"""What two busy cores may add to any measured time."""


def client(locator, lease_s=1.0, config=None):
    """Open a Zenoh session as a driver would, with a configuration file if it needs one."""
    settings, _ = client_config(locator, config)
    settings.insert_json5("transport/link/tx/lease", str(round(lease_s * 1000)))
    settings.insert_json5("connect/timeout_ms", "20000")  # as long as a busy machine may take
    return zenoh.open(settings)


class Driver(DriverClient, ClosedAtExit):
    """A driver with a Zenoh session; it receives all that others publish on ``keys``.

    Without a configuration of its own it waits until it may drive.
    """

    keys = ("**",)

    def __init__(self, locator, namespace="", lease_s=1.0, config=None):
        super().__init__(self, namespace)
        self.session = client(locator, lease_s, config)
        remote = zenoh.Locality.REMOTE
        self._subscribers = [
            self.session.declare_subscriber(self.prefix + key, self._heard, allowed_origin=remote)
            for key in self.keys
        ]
        self._commands = self.session.declare_publisher(self.prefix + "cmd_vel")
        if config is None:
            self.wait_for(lambda: self.may_drive)

    def _heard(self, sample):
        self.receive(str(sample.key_expr).removeprefix(self.prefix), sample.payload.to_bytes())

    now_ns = property(lambda self: time.monotonic_ns())
    may_drive = property(lambda self: self._commands.matching_status.matching)
    time_ns = staticmethod(time.time_ns)
    sleep = staticmethod(time.sleep)

    @staticmethod
    def wait_for(condition, seconds=20.0):
        """Wait as long as a busy machine may take: bounds are the tests' own."""
        return wait_for(condition, seconds)

    def query(self, name, payload, attachment=None, timeout_s=3.0):
        """Return the bytes of the one answer, or the error's text. Raises FormatError without one."""
        where = self.prefix + name
        replies = list(self.session.get(where, payload=payload, attachment=attachment, timeout=timeout_s))
        if len(replies) != 1:
            raise FormatError(f"{len(replies)} answers on {where}, expected one")
        return replies[0].ok.payload.to_bytes() if replies[0].ok else replies[0].err.payload.to_string()

    def command(self, payload, attachment=None):
        self._commands.put(payload, attachment=attachment)

    def close(self):
        self.session.close()


def braking_s(v):
    """Time in s from the stop command to standstill at speed ``v``: the base's own delay, then braking."""
    return DELAY_S + abs(v) / BRAKING_M_S2
