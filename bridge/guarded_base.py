"""A base whose exceptions count as its loss: whatever a base raises, the bridge keeps running."""

from collections.abc import Callable, Sequence
from contextlib import suppress

from bridge.base import Base, BaseEvent, BaseReport, BaseTimeout, LinkHealth, Lost, Notice, Ready, Setpoint
from rover_ncp.core.errors import NoRobot, RoverNcpError
from rover_ncp.core.geometry import STANDSTILL
from rover_ncp.wire.protocol import TimeoutState


class GuardedBase:
    """A `Base` that raises NoRobot before it was ever ready, and nothing later.

    After an exception the base is called on, as a line is opened again. Its reports count again once it has
    taken a setpoint.
    """

    def __init__(self, base: Base) -> None:
        self._base = base
        self._was_ready = self._driven = False
        self._problem = ""
        """The exception by which the base is lost; "" without one."""

    def receive(self, arrival: object, now: float) -> Sequence[BaseEvent]:
        return self._events(lambda: self._base.receive(arrival, now))

    def drive(self, setpoint: Setpoint, now: float) -> Sequence[BaseEvent]:
        self._driven = True
        return self._events(lambda: self._base.drive(setpoint, now))

    def health(self) -> LinkHealth:
        with suppress(Exception):
            return self._base.health()
        return LinkHealth(damaged=True, counters={})

    @property
    def base_timeout(self) -> BaseTimeout:
        try:
            return self._base.base_timeout
        except Exception as error:
            return BaseTimeout(TimeoutState.UNKNOWN, None, _words(error))

    def shut_down(self, now: float) -> list[str]:
        """Stop the base, switch its motors off, then close it; return what failed."""
        stop = Setpoint(STANDSTILL, motors=False, emergency=False)
        found = [self._text(lambda: self._base.drive(stop, now)), self._text(lambda: self._base.close(now))]
        return [problem for problem in found if problem]

    @staticmethod
    def _text(call: Callable[[], object]) -> str:
        """Return a call's text, or why it failed; "" for other results."""
        try:
            result = call()
        except Exception as error:
            return _words(error)
        return result if isinstance(result, str) else ""

    def _events(self, call: Callable[[], Sequence[BaseEvent]]) -> Sequence[BaseEvent]:
        try:
            events = list(call())
        except Exception as error:
            if not self._was_ready:
                raise NoRobot(_words(error)) from error
            known, self._problem, self._driven = self._problem, _words(error), False
            return [] if known else [Lost(self._problem)]
        self._was_ready |= any(isinstance(event, Ready) for event in events)
        if not self._problem:
            return events
        if self._driven and any(isinstance(event, BaseReport) for event in events):
            self._problem = ""
            return [Notice("the base works again"), *events]
        return [event for event in events if not isinstance(event, BaseReport)]


def _words(error: Exception) -> str:
    plain = isinstance(error, OSError | RoverNcpError)
    return f"the base failed: {error if plain else repr(error)}"
