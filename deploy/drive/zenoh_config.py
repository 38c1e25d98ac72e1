"""Configuration of the driver's Zenoh session. Values are measured; see the comments beside them."""

import json
import re
import socket
from pathlib import Path

import zenoh

from rover_ncp.core.errors import FileError, NoBridge, NotAuthorised, UnreachableError, UsageError
from rover_ncp.core.files import existing_file

PORT = 7447
"""Zenoh's own port, where the bridge listens."""

MOST_PORT = 65535

PROBE_S = 1.0

_LOCATOR = re.compile(
    r"(?P<protocol>[a-z]+)/(?P<host>\[[0-9A-Fa-f:.]+\]|[^/:#?\s]+)(?P<port>:\d+)?(?P<rest>[#?]\S*)?"
)

_SETTINGS = {
    "mode": "client",
    "scouting/multicast/enabled": False,
    "scouting/gossip/enabled": False,
    # How long we may be silent before the bridge drops us; it must be announced by the silent side.
    "transport/link/tx/lease": 1000,
    "transport/link/tx/keep_alive": 4,
    "transport/shared_memory/enabled": False,
    "connect/timeout_ms": 2000,
    # The default waits up to 4 s between attempts, which made reconnecting as slow.
    "connect/retry": {"period_init_ms": 100, "period_max_ms": 500, "period_increase_factor": 1.5},
}


def locator(robot: str) -> str:
    """Return ``robot`` as a Zenoh locator, with the default port if it has none. Raises UsageError."""
    match = _LOCATOR.fullmatch(robot)
    if match is None:
        raise UsageError(
            f"--robot {robot}: expected PROTOCOL/HOST[:PORT], for example tcp/192.168.1.20:{PORT}"
        )
    if match["port"] is not None and not 1 <= int(match["port"][1:]) <= MOST_PORT:
        raise UsageError(f"--robot {robot}: expected a port from 1 to {MOST_PORT}")
    return f"{match['protocol']}/{match['host']}{match['port'] or f':{PORT}'}{match['rest'] or ''}"


def refused(endpoint: str) -> UnreachableError:
    """Return the error for a failed session, as far as its cause shows from outside."""
    match = _LOCATOR.fullmatch(endpoint)
    assert match is not None  # or there would have been no session to open
    try:
        # Zenoh says the same of an empty port and of one that sent us away.
        socket.create_connection((match["host"].strip("[]"), int(match["port"][1:])), PROBE_S).close()
    except OSError:
        return NoBridge(
            f"nothing answers at {endpoint}: is 'rover-ncp bridge' running there, listening on that address?"
        )
    return NotAuthorised(
        f"not authorised: the process at {endpoint} accepts no session from us; it may want a certificate, "
        "user and password (--zenoh-config, see 'rover-ncp keys'), or is no bridge, or hangs"
    )


def client_config(robot: str, file: Path | None) -> tuple[zenoh.Config, str]:
    """Return the session's configuration and the bridge's locator.

    ``file`` may hold what a network needs (TLS, user and password); how the driver connects and how soon its
    silence is noticed is not up to it. Raises UsageError and FileError.
    """
    endpoint = locator(robot)
    if file is not None:
        existing_file(file)
    try:
        config = zenoh.Config() if file is None else zenoh.Config.from_file(str(file))
    except zenoh.ZError as error:
        raise FileError(f"{file}: not a Zenoh configuration: {error}") from error
    for path, value in {**_SETTINGS, "connect/endpoints": [endpoint]}.items():
        config.insert_json5(path, json.dumps(value))
    return config, endpoint
