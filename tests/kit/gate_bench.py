"""A gate with its state, and the clock of a driver, which differs from the bridge's.

Digests are verified before the gate: here a command or a request says whether it is signed by the holder.
"""

from bridge.base import BaseReport
from bridge.gate.gate import step
from bridge.gate.limits import Fence, Limits
from bridge.gate.state import BaseLost, Enable, GateState, Release, ReleaseStop, Stop, Tick, VelocityCommand
from rover_ncp.core.geometry import Velocity
from rover_ncp.wire.protocol import CommandTag

SECRET = bytes(range(32))
SLOW = Velocity(0.1, -0.1)
LIMITS = Limits()
BOX = Fence(x_min=-1.0, x_max=2.0, y_min=-1.0, y_max=1.0)


def limits(**changed):
    return LIMITS.model_copy(update=changed)


def steps(first, last, step_s):
    """Return moments from ``first`` to ``last``, without the errors of sums."""
    return [round(first + k * step_s, 9) for k in range(round((last - first) / step_s) + 1)]


class Gate:
    """A gate with its state. Times are the bridge's; the driver's clock differs by ``ahead_s``."""

    def __init__(self, limits=LIMITS, ahead_s=1234.5):
        self.state, self.limits, self.ahead_s = GateState(), limits, ahead_s
        self.sequence = 0
        self.report_again = None
        """The base repeats this report, if there is one, before each command and request."""

    def at(self, now, event):
        if self.report_again is not None and isinstance(event, Enable | VelocityCommand):
            self.state, _ = step(self.state, self.report_again, now, self.limits)
        self.state, verdict = step(self.state, event, now, self.limits)
        return verdict

    def report(self, now, **fields):
        return self.at(now, BaseReport(**fields))

    def keep(self, now, **fields):
        """Report, and repeat it before each command and request."""
        self.report_again = BaseReport(**fields)
        return self.at(now, self.report_again)

    def tick(self, now):
        return self.at(now, Tick())

    def lost(self, now, restarted=False):
        return self.at(now, BaseLost(restarted=restarted))

    def stop(self, now, reason):
        return self.at(now, Stop(reason))

    def unstop(self, now):
        return self.at(now, ReleaseStop())

    def place(self, now, base):
        """Report a base that has driven to its pose since the last report."""
        self.state = self.state._replace(base=BaseReport(base.x, base.y, base.theta))
        return self.at(now, base)

    def stamp(self, now):
        return round((now + self.ahead_s) * 1e9)

    def _numbered(self, sequence):
        """Return a given number, or the next one."""
        if sequence is None:
            self.sequence += 1
            return self.sequence
        return sequence

    def drive(self, now, velocity=SLOW, signed=True, age=0.0, sequence=None, shift_ns=0):
        """A command that was sent ``age`` seconds and ``shift_ns`` before it arrives at ``now``."""
        tag = CommandTag(1, self._numbered(sequence), self.stamp(now - age) - shift_ns)
        return self.at(now, VelocityCommand(velocity, tag, signed=signed))

    def enable(self, now, secret=SECRET, age=0.0):
        """A request for the motors by a new driver."""
        return self.at(now, Enable("deploy", self.stamp(now - age), secret))

    def renew(self, now, sequence=None, secret=SECRET):
        """A signed request of the driver that holds the lease."""
        return self.at(now, Enable("deploy", self.stamp(now), secret, self._numbered(sequence)))

    def release(self, now, sequence=None):
        """A signed release."""
        return self.at(now, Release(self._numbered(sequence)))

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
