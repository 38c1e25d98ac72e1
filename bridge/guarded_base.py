"""A base whose exceptions end the bridge: each becomes an error in one line."""

from collections.abc import Callable, Sequence
from typing import TypeVar

from bridge.base import Base, BaseEvent, BaseTimeout, LinkHealth, Setpoint
from rover_ncp.core.errors import NoRobot, RoverNcpError
from rover_ncp.core.geometry import STANDSTILL

ResultT = TypeVar("ResultT")


class GuardedBase:
    """A `Base` that raises nothing but NoRobot."""

    def __init__(self, base: Base) -> None:
        self._base = base

    def receive(self, arrival: object, now: float) -> Sequence[BaseEvent]:
        return _guarded(lambda: list(self._base.receive(arrival, now)))

    def drive(self, setpoint: Setpoint, now: float) -> Sequence[BaseEvent]:
        return _guarded(lambda: list(self._base.drive(setpoint, now)))

    def health(self) -> LinkHealth:
        return _guarded(self._base.health)

    @property
    def base_timeout(self) -> BaseTimeout:
        return _guarded(lambda: self._base.base_timeout)

    def shut_down(self, now: float) -> list[str]:
        """Stop the base, switch its motors off, then close it; return what failed."""
        stop = Setpoint(STANDSTILL, motors=False, emergency=False)
        failed = []
        for call in (lambda: self.drive(stop, now), lambda: _guarded(lambda: self._base.close(now))):
            try:
                call()
            except NoRobot as error:
                failed.append(str(error))
        return failed


def _guarded(call: Callable[[], ResultT]) -> ResultT:
    """Call a method of the base. Raises NoRobot for any exception of it."""
    try:
        return call()
    except Exception as error:
        plain = isinstance(error, OSError | RoverNcpError)
        raise NoRobot(f"the base failed: {error if plain else repr(error)}") from error
