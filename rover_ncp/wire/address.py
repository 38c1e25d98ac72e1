"""Addresses of bases, robots and bridges: ``PROTOCOL/HOST[:PORT][#SETTINGS]``."""

import re
from typing import NamedTuple

_FORM = re.compile(r"([a-z]+)/(\[[0-9A-Fa-f:.]+\]|[^/:#?\[\]\s]+)(?::(\d+))?([#?]\S*)?")
MAX_PORT = 65535


class Address(NamedTuple):
    """One end of a connection. ``host`` has no brackets; ``settings`` begins with ``#`` or ``?``."""

    protocol: str
    host: str
    port: int
    settings: str = ""

    @property
    def connectable(self) -> bool:
        """Whether the port is one to connect to."""
        return 0 < self.port <= MAX_PORT

    def __str__(self) -> str:
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"{self.protocol}/{host}:{self.port}{self.settings}"


def parse_address(text: str, default_port: int) -> Address | None:
    """Read an address; None for another form. The port may be any number."""
    match = _FORM.fullmatch(text)
    if match is None:
        return None
    protocol, host, port, settings = match.groups()
    number = default_port if port is None else int(port)
    return Address(protocol, host.strip("[]"), number, settings or "")
