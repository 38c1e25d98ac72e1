"""The rate of a serial line: the search for the base's rate, and the request for a faster one.

A base begins at the rate in its FLASH, 9600 as shipped, takes another with HOSTBAUD, and goes back to its own
with CLOSE. At 9600 a SIP with 16 sonars fills 93 ms of its 100 (Adept Pioneer 3 manual p. 43), so ARIA asks
for 38400 whenever the CONFIGpac says AUTOBAUD 2; a client that vanished leaves the base at that rate.
"""

from bridge.pioneer.packets import ConfigPac

RATES = (9600, 19200, 38400, 57600, 115200)
"""By the argument of HOSTBAUD."""

FAST = 38400
"""The rate in ARIA's parameter files (SwitchToBaudRate)."""

CAN_SWITCH = 2
"""AUTOBAUD of a base that takes another rate in a session (ARIA switches only then)."""

_SEARCHED = (9600, 38400, 115200, 19200, 57600)
"""ARIA's order of looking for a base that does not answer."""


class Rates:
    """The rate at which a line runs, None for a line without one, and the rates to try on it."""

    def __init__(self) -> None:
        self.begin(None)

    def begin(self, rate: int | None) -> None:
        """Take over a line just opened at this rate."""
        self.current = self._before_switch = rate
        self.search = () if rate is None else (rate, *(other for other in _SEARCHED if other != rate))
        """In the order of trying, from the rate that the line was opened at."""

    def look(self, attempt: int) -> int | None:
        """Go to the rate of the n-th attempt, from 0, and return it; None if it is the present one."""
        before = self.current
        if self.search:
            self.current = self.search[attempt % len(self.search)]
        return None if self.current == before else self.current

    def faster(self, config: ConfigPac | None) -> int | None:
        """Return HOSTBAUD's argument for a faster line, if there is a rate and the base can."""
        able = config is not None and config.autobaud == CAN_SWITCH
        if not able or self.current is None or self.current >= FAST:
            return None
        return RATES.index(FAST)

    def switch(self) -> int:
        """Go to the fast rate."""
        self._before_switch, self.current = self.current, FAST
        return FAST

    def back(self) -> int | None:
        """Go back to the rate before the switch."""
        self.current = self._before_switch
        return self.current
