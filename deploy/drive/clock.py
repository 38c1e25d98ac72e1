"""Due times of ticks and measurement times of samples, without a clock. All times are arguments, in ns.

Two plain objects. `RateKeeper` holds the absolute schedule of control ticks: tick k is due at
``start + k · period`` whatever happened before, so that lateness never adds up. The first odometry measured
within half a period of a due time sets the tick off; when that half period is over without one, the tick
runs on prediction and is counted as an overrun. `StampClock` finds the moment of a measurement on our own
clock from the sender's stamps, whose zero is unknown and whose rate is almost ours.
"""

from collections import deque
from typing import NamedTuple

import numpy as np

NS = 1_000_000_000
"""Nanoseconds in a second."""


class RateReport(NamedTuple):
    """How well a schedule was kept."""

    ticks: int
    overruns: int
    """Ticks that ran on prediction, and ticks that did not run at all."""
    predicted: int
    missed: int
    rate_hz: float
    lateness_p50_ms: float
    lateness_max_ms: float
    """After the due time; a tick may also be early, which counts as negative."""


class RateKeeper:
    """The schedule of control ticks; ``index`` is the one that comes next."""

    def __init__(self, period_ns: int, start_ns: int) -> None:
        if period_ns <= 0:
            raise ValueError(f"the period must be positive, got {period_ns} ns")
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
        """Odometry measured from this moment on sets the next tick off."""
        return self.due_ns - self._period // 2

    @property
    def deadline_ns(self) -> int:
        """At this moment the next tick runs on prediction."""
        return self.due_ns + self._period // 2

    @property
    def overruns(self) -> int:
        """Ticks that had to run without fresh odometry, or could not run in time at all."""
        return self.predicted + self.missed

    def skip_missed(self, now_ns: int) -> int:
        """Give up ticks whose whole successor's window is over too; return how many.

        A process that was held up goes on where the schedule stands: old ticks run late in a burst would
        show the circuit a time that has passed.
        """
        missed = max(0, (now_ns - self.deadline_ns) // self._period)
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
            rate_hz=(ticks - 1) * NS / span if span > 0 else 0.0,
            lateness_p50_ms=float(np.median(late_ms)),
            lateness_max_ms=float(late_ms.max()),
        )


class StampClock:
    """The moment of a measurement on the receiver's clock, from the sender's stamp and the arrival.

    Arrival minus stamp is an unknown constant plus the time on the way. Its smallest value within the last
    minute stands for the constant and the shortest way; what a sample took beyond that is its age.
    """

    WINDOW_NS = 60 * NS

    def __init__(self, in_order: bool = True) -> None:
        self._in_order = in_order
        self._smallest: deque[tuple[int, int]] = deque()  # (arrival, arrival − stamp), both rising
        self._measured_ns: int | None = None

    def measured_ns(self, stamp_ns: int, arrival_ns: int) -> int:
        """Return when the sample was measured, on the receiver's clock.

        Where samples come in order, never before the one before it.
        """
        offset = arrival_ns - stamp_ns
        while self._smallest and self._smallest[-1][1] >= offset:
            self._smallest.pop()
        self._smallest.append((arrival_ns, offset))
        while self._smallest[0][0] < arrival_ns - self.WINDOW_NS:
            self._smallest.popleft()
        measured = stamp_ns + self._smallest[0][1]
        if self._in_order and self._measured_ns is not None:
            measured = max(measured, self._measured_ns)
        self._measured_ns = measured
        return measured
