"""A Pioneer as a `Base`: an ARCOS session on a line."""

import math
from collections.abc import Sequence

from bridge.base import BaseEvent, BaseTimeout, Failed, LinkHealth, Lost, Notice, Ready, Setpoint
from bridge.pioneer.connection import BaseConnection, Broken, Opened, Received
from bridge.pioneer.session import BaudChanged, Session, SessionEvent
from rover_ncp.core.geometry import STANDSTILL
from rover_ncp.wire.protocol import TimeoutState

WATCHDOG_S = 2.0
"""The firmware's watchdog as delivered (Pioneer 3 operations manual), and the longest one that is driven.

A lost base has halted after this time (``states.py``), before the bridge sends to it again.
"""

DAMAGED_S = 10.0
"""How long the line counts as damaged after a bad checksum."""


class ArcosBase:
    """One Pioneer."""

    def __init__(self, connection: BaseConnection, session: Session) -> None:
        self._connection, self._session = connection, session
        self._last = Setpoint(STANDSTILL, motors=False, emergency=False)
        self._was_ready = self._reopening = False
        self._refusal = ""
        self._bad_checksums, self._damaged_until_s, self._now = 0, -math.inf, 0.0

    def receive(self, arrival: object, now: float) -> Sequence[BaseEvent]:
        events: list[SessionEvent] = []
        match arrival:
            case Received(data):
                events = self._session.receive(data, now)
            case Opened(baudrate):
                self._connection.use()
                self._session.connect(now, baudrate)
            case Broken(error) if self._was_ready:
                self._connection.drop()
                events = self._session.link_down(str(error), now)
            case Broken(error):
                return [Failed(str(error))]
        return self._pass_on(events)

    def drive(self, setpoint: Setpoint, now: float) -> Sequence[BaseEvent]:
        last, self._last = self._last, setpoint
        self._now, bad_checksums = now, self._session.decoder.bad_checksums
        if bad_checksums > self._bad_checksums:
            self._bad_checksums, self._damaged_until_s = bad_checksums, now + DAMAGED_S
        if setpoint.motors != last.motors or setpoint.lease not in {0, last.lease}:
            self._session.enable(setpoint.motors)
        if setpoint.emergency and not last.emergency:
            self._session.emergency_stop()
        self._session.set_motion(setpoint.velocity)
        return self._pass_on(self._session.tick(now))

    def health(self) -> LinkHealth:
        decoder = self._session.decoder
        counters = {name: getattr(decoder, name) for name in ("packets", "bad_checksums", "skipped_bytes")}
        unheard = ("its gyro, which HasGyro in its FLASH names",) if self._session.gyro_silent else ()
        return LinkHealth(self._now < self._damaged_until_s, counters, unheard=unheard)

    @property
    def base_timeout(self) -> BaseTimeout:
        watchdog_s = self._session.watchdog_s
        if watchdog_s is None:  # old controllers send no configuration
            return BaseTimeout(TimeoutState.UNKNOWN, WATCHDOG_S)
        if 0.0 < watchdog_s <= WATCHDOG_S:
            return BaseTimeout(TimeoutState.PUBLISHED, watchdog_s)
        words = f"the base's watchdog is {watchdog_s:g} s; set WatchDog in its FLASH to 1 to 2000 ms"
        return BaseTimeout(TimeoutState.UNKNOWN, None, words)

    def close(self, now: float) -> None:
        self._session.close(now)
        self._pass_on([])
        self._connection.close()

    def _pass_on(self, events: list[SessionEvent]) -> list[BaseEvent]:
        """Act on what concerns the line, send what the session has for the base, and return the rest."""
        passed: list[BaseEvent] = []
        for event in events:
            match event:
                case BaudChanged(baudrate):
                    self._connection.set_baudrate(baudrate)
                case Failed(reason):
                    if self._was_ready:
                        self._connection.reopen(reason)
                    if not self._reopening:  # said once
                        passed.append(Failed(f"{self._connection.endpoint}: {reason}"))
                    self._reopening = True
                case Ready():
                    self._was_ready, self._reopening = True, False
                    passed.append(event)
                case _:
                    passed.append(event)
        self._connection.write(self._session.data_to_send())
        refusal = self.base_timeout.refusal
        if self._was_ready and refusal not in {"", self._refusal}:
            # A configuration that arrives late ends a lease that was granted before, also in this very turn.
            begins = any(isinstance(event, Ready) for event in passed)
            passed.append(Notice(refusal) if begins else Lost(refusal))
        if self._was_ready:
            self._refusal = refusal
        return passed
