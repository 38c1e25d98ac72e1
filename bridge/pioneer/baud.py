"""The rate of a serial line: looking for the one a base listens at, and asking for a faster one.

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
    """The rate a line was opened with, and the one it runs at. Neither exists on a line that has no rate."""

    def __init__(self) -> None:
        self.home: int | None = None
        self.current: int | None = None
        self.before: int | None = None
        """The rate that a switch would be taken back to."""

    def begin(self, home: int | None) -> None:
        """Take over a line just opened at this rate."""
        self.home = self.current = self.before = home

    @property
    def tries(self) -> int:
        """Number of further tries without an answer until every rate has been tried."""
        return 0 if self.home is None else len(self._search())

    def look(self, attempt: int) -> int | None:
        """Go to the rate of the n-th attempt, from 0; return it if that is another than now."""
        if self.home is None:
            return None
        search = self._search()
        return self._go(search[attempt % len(search)])

    def faster(self, config: ConfigPac | None) -> int | None:
        """Return HOSTBAUD's argument for a faster line, if there is a rate and the base can."""
        able = config is not None and config.autobaud == CAN_SWITCH
        if not able or self.current is None or self.current >= FAST:
            return None
        return RATES.index(FAST)

    def switch(self) -> int:
        """Go to the fast rate."""
        self.before, self.current = self.current, FAST
        return FAST

    def back(self) -> int | None:
        """Go back to the rate before the switch."""
        self.current = self.before
        return self.current

    def _go(self, rate: int) -> int | None:
        changed, self.current = rate != self.current, rate
        return rate if changed else None

    def _search(self) -> tuple[int, ...]:
        assert self.home is not None
        return (self.home, *(rate for rate in _SEARCHED if rate != self.home))
