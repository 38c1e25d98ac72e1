"""A gate with its state, and a driver's clock that differs from the bridge's.

Digests are verified before the gate: here a command or a request says whether it is signed by the holder.
"""

from dataclasses import replace

from bridge.base import BaseReport
from bridge.gate.gate import step
from bridge.gate.limits import Limits
from bridge.gate.state import Enable, GateState, Release, VelocityCommand
from rover_ncp.core.geometry import Velocity
from rover_ncp.wire.protocol import CommandTag

SECRET = bytes(range(32))
SLOW = Velocity(0.1, -0.1)
LIMITS = Limits()


class Gate:
    """A gate with its state. Times are the bridge's; the driver's clock differs by ``ahead_s``."""

    def __init__(self, limits=LIMITS, accept_ros=False, ahead_s=1234.5):
        self.state, self.limits, self.accept_ros, self.ahead_s = GateState(), limits, accept_ros, ahead_s
        self.sequence = 0

    def at(self, now, event):
        self.state, verdict = step(self.state, event, now, self.limits, self.accept_ros)
        return verdict

    def place(self, now, base):
        """Report a base that has driven to its pose since the last report."""
        self.state = replace(self.state, base=BaseReport(base.x, base.y, base.theta))
        return self.at(now, base)

    def stamp(self, now):
        return round((now + self.ahead_s) * 1e9)

    def drive(self, now, velocity=SLOW, signed=True, age=0.0, sequence=None):
        """A command that was sent ``age`` seconds before it arrives at ``now``."""
        if sequence is None:
            self.sequence += 1
            sequence = self.sequence
        tag = CommandTag(1, sequence, self.stamp(now - age))
        return self.at(now, VelocityCommand(velocity, tag, signed=signed))

    def enable(self, now, secret=SECRET, age=0.0):
        """A request for the motors by a new driver."""
        return self.at(now, Enable("deploy", self.stamp(now - age), secret))

    def renew(self, now, sequence=None, secret=SECRET):
        """A signed request of the driver that holds the lease."""
        if sequence is None:
            self.sequence += 1
            sequence = self.sequence
        return self.at(now, Enable("deploy", self.stamp(now), secret, sequence))

    def release(self, now, sequence=None):
        """A signed release."""
        if sequence is None:
            self.sequence += 1
            sequence = self.sequence
        return self.at(now, Release(sequence))

    def driving(self, now=0.0):
        """Bring the gate to where a command is in force since ``now``, at full size."""
        self.at(now - 0.3, BaseReport(motors_on=False))
        assert self.enable(now - 0.3).refusal is None
        self.at(now - 0.2, BaseReport())
        for k in (2, 1, 0):
            verdict = self.drive(now - 0.05 * k)
        self.at(now, BaseReport())
        assert verdict.velocity == SLOW
        return self
