"""The absolute schedule of control ticks, without a clock. All times are arguments, in ns.

Tick k is due at ``start + k · period``, so delays never accumulate. The first odometry measured within half a
period of the due time triggers the tick. Without any, the tick runs on prediction and counts as an overrun.
"""

from typing import NamedTuple

from rover_ncp.core.clock_offset import NS_PER_S


class RateReport(NamedTuple):
    """How well a schedule was kept."""

    ticks: int
    overruns: int
    """Ticks that ran on prediction, and ticks that did not run at all."""
    tick_rate_hz: float


class RateKeeper:
    """The schedule of control ticks; ``index`` is the next one."""

    def __init__(self, period_ns: int, start_ns: int) -> None:
        self._period, self._start = period_ns, start_ns
        self.index = 0
        self.overruns = 0
        """Ticks without fresh odometry, and ticks that could not run in time at all."""
        self._ticks = 0
        self._first_ns = self._last_ns = start_ns

    @property
    def due_ns(self) -> int:
        """When the next tick is due."""
        return self._start + self.index * self._period

    @property
    def opens_ns(self) -> int:
        """Odometry measured from this moment on triggers the next tick."""
        return self.due_ns - self._period // 2

    @property
    def deadline_ns(self) -> int:
        """At this moment the next tick runs on prediction."""
        return self.due_ns + self._period // 2

    def skip_missed(self, now_ns: int, end: int) -> int:
        """Skip ticks before ``end`` whose successor's window is over too; return their number.

        Old ticks in a burst would give the circuit a time that has passed.
        """
        missed = max(0, min((now_ns - self.deadline_ns) // self._period, end - self.index))
        self.index += missed
        self.overruns += missed
        return missed

    def ticked(self, now_ns: int, predicted: bool) -> None:
        """Note that the next tick ran at ``now_ns``, and move on to its successor."""
        if not self._ticks:
            self._first_ns = now_ns
        self._last_ns = now_ns
        self._ticks += 1
        self.overruns += predicted
        self.index += 1

    def report(self) -> RateReport:
        """Return the figures of the whole run."""
        span = self._last_ns - self._first_ns
        rate_hz = (self._ticks - 1) * NS_PER_S / span if span > 0 else 0.0
        return RateReport(self._ticks, self.overruns, rate_hz)
