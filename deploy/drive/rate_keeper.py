"""The absolute schedule of control ticks, without a clock. All times are arguments, in ns.

Tick k is due at ``start + k · period``, so delays never accumulate. The first odometry measured within half a
period of the due time triggers the tick. Without any, the tick runs on prediction and counts as an overrun.
"""

from typing import NamedTuple

import numpy as np

from rover_ncp.core.clock_offset import NS_PER_S


class RateReport(NamedTuple):
    """How well a schedule was kept."""

    ticks: int
    overruns: int
    """Ticks that ran on prediction, and ticks that did not run at all."""
    predicted: int
    missed: int
    tick_rate_hz: float
    lateness_ms: dict[str, float]
    """Median and maximum of the time after the due time; negative for an early tick."""


class RateKeeper:
    """The schedule of control ticks; ``index`` is the next one."""

    def __init__(self, period_ns: int, start_ns: int) -> None:
        self._period, self._start = period_ns, start_ns
        self.index = 0
        self.predicted = 0
        self.missed = 0
        self._lateness_ns: list[int] = []
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

    @property
    def overruns(self) -> int:
        """Ticks without fresh odometry, and ticks that could not run in time at all."""
        return self.predicted + self.missed

    def skip_missed(self, now_ns: int, end: int) -> int:
        """Skip ticks before ``end`` whose successor's window is over too; return their number.

        Old ticks in a burst would give the circuit a time that has passed.
        """
        missed = max(0, min((now_ns - self.deadline_ns) // self._period, end - self.index))
        self.index += missed
        self.missed += missed
        return missed

    def ticked(self, now_ns: int, predicted: bool) -> None:
        """Note that the next tick ran at ``now_ns``, and move on to its successor."""
        if not self._lateness_ns:
            self._first_ns = now_ns
        self._last_ns = now_ns
        self._lateness_ns.append(now_ns - self.due_ns)
        self.predicted += predicted
        self.index += 1

    def report(self) -> RateReport:
        """Return the figures of the whole run."""
        ticks, span = len(self._lateness_ns), self._last_ns - self._first_ns
        late_ms = np.array(self._lateness_ns or [0]) / 1e6
        return RateReport(
            ticks=ticks,
            overruns=self.overruns,
            predicted=self.predicted,
            missed=self.missed,
            tick_rate_hz=(ticks - 1) * NS_PER_S / span if span > 0 else 0.0,
            lateness_ms={"p50": float(np.median(late_ms)), "max": float(late_ms.max())},
        )
