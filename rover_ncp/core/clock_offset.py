"""The offset between a sender's clock and the receiver's, from stamps and arrivals. Pure.

Arrival minus stamp is an unknown constant plus the transit time. Its minimum over the last minute is the
offset; the excess of a message over it is the message's age. A constant delay does not reset the offset: on a
link that became slow, all messages are old.
"""

import math
from typing import NamedTuple

NS_PER_S = 1_000_000_000
KEPT_S = 60
"""How long a minimum counts: clocks that drift 100 ppm differ by 6 ms in it."""
JUMP_NS = 100_000_000
"""Offsets that differ by more than this are of two clocks, or one of the stamps is bad."""


def update_clock_offset(
    minima: tuple[tuple[int, float], ...], now: float, stamp_ns: int
) -> tuple[tuple[int, float], ...]:
    """Add (arrival − stamp) to the minima of the last minute, one a second."""
    second, offset = math.floor(now), now - stamp_ns * 1e-9
    kept = tuple(item for item in minima if second - item[0] <= KEPT_S)
    if kept and kept[-1][0] == second:
        return (*kept[:-1], (second, min(offset, kept[-1][1])))
    return (*kept, (second, offset))


class _Arrival(NamedTuple):
    stamp_ns: int
    arrival_ns: int

    @property
    def offset_ns(self) -> int:
        return self.arrival_ns - self.stamp_ns


class StampClock:
    """The clock that stamps one topic. It may be set, forward or back, and single stamps may be bad.

    A stamp that goes back, or is ahead of the offset, is doubted until the next message shows which is right:
    the offset of the last valid stamp or that of the doubted one, whichever is nearer to its own. So a bad
    stamp costs one message, and so does a clock that is set.
    """

    def __init__(self, in_order: bool = True) -> None:
        self._in_order = in_order
        self._zero = _Arrival(0, 0)
        """Seconds count from here, so that they are exact to the nanosecond."""
        self._minima: tuple[tuple[int, float], ...] = ()
        self._last: _Arrival | None = None
        self._doubted: _Arrival | None = None
        self._measured_ns: int | None = None
        self.set_back_s = 0.0
        """By how much the clock was set back, as the newest message shows; else 0."""
        self.doubt_s = 0.0
        """How far the offset of the newest message is from the last valid one's, if it is doubted; else 0."""
        self.late_ns: int | None = None
        """When the message before the newest was measured, if it was doubted and only came out of order.

        None for messages that are in order.
        """

    def measured_ns(self, stamp_ns: int, arrival_ns: int) -> int | None:
        """Return when a message was measured, on the receiver's clock; None while its stamp is doubted.

        For messages in order it is never before the previous one.
        """
        self.set_back_s, self.doubt_s, self.late_ns = 0.0, 0.0, None
        seen, doubted, self._doubted = _Arrival(stamp_ns, arrival_ns), self._doubted, None
        if doubted is not None and self._last is not None:
            self._decide(seen, doubted, self._last)
        if self._last is not None:
            jump_ns = seen.offset_ns - self._last.offset_ns
            back = stamp_ns <= self._last.stamp_ns and jump_ns > JUMP_NS
            if back or self._age_ns(seen) < -JUMP_NS:
                self._doubted, self.doubt_s = seen, abs(jump_ns) * 1e-9
                return None
        self._add(seen)
        measured_ns = arrival_ns - self._age_ns(seen)
        if self._in_order and self._measured_ns is not None:
            measured_ns = max(measured_ns, self._measured_ns)
        self._measured_ns = measured_ns
        return measured_ns

    def sender_ns(self, moment_ns: int) -> int | None:
        """Return the sender's time at a moment, at most a transit behind; None before the first message."""
        if self._last is None:
            return None
        return moment_ns - self._offset_ns

    def receiver_ns(self, stamp_ns: int) -> int | None:
        """Return the receiver's time of a sender's stamp, with the least transit; None before any message."""
        return None if self._last is None else stamp_ns + self._offset_ns

    def _decide(self, seen: _Arrival, doubted: _Arrival, last: _Arrival) -> None:
        from_doubted, from_last = (abs(seen.offset_ns - other.offset_ns) for other in (doubted, last))
        # Messages that waited somewhere arrive in a burst: their offsets are near, whatever their clock.
        stamps_ns, arrivals_ns = seen.stamp_ns - doubted.stamp_ns, seen.arrival_ns - doubted.arrival_ns
        if 0 < stamps_ns < 2 * arrivals_ns and from_doubted < from_last:
            self.set_back_s = max(doubted.offset_ns - last.offset_ns, 0) * 1e-9
            self._last = None
            self._add(doubted)
        elif not self._in_order and doubted.stamp_ns <= last.stamp_ns:
            self.late_ns = doubted.arrival_ns - self._age_ns(doubted)

    def _add(self, seen: _Arrival) -> None:
        if self._last is None:
            self._zero, self._minima = seen, ()
        arrival_s = (seen.arrival_ns - self._zero.arrival_ns) * 1e-9
        self._minima = update_clock_offset(self._minima, arrival_s, seen.stamp_ns - self._zero.stamp_ns)
        self._last = seen

    @property
    def _offset_s(self) -> float:
        return min(offset for _, offset in self._minima)

    @property
    def _offset_ns(self) -> int:
        """The receiver's clock minus the sender's, with the least transit."""
        return self._zero.offset_ns + round(self._offset_s * 1e9)

    def _age_ns(self, seen: _Arrival) -> int:
        """Return the excess over the offset; negative if no message came as soon after its stamp."""
        return round(((seen.offset_ns - self._zero.offset_ns) * 1e-9 - self._offset_s) * 1e9)
