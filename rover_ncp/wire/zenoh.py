"""Configuration of every Zenoh client in this project; the values are measured."""

import json
import re
from datetime import UTC, datetime
from itertools import accumulate
from pathlib import Path
from typing import Any

import zenoh

from rover_ncp.core.config import MAX_DEPTH
from rover_ncp.core.errors import FileError, NoRobot, UsageError
from rover_ncp.core.files import read_text
from rover_ncp.wire.address import MAX_PORT, parse_address
from rover_ncp.wire.certificate_dates import require_valid
from rover_ncp.wire.probe import Listener, listener_at

PORT = 7447
"""Zenoh's own port, where bridge and routers listen."""

CLIENT: dict[str, Any] = {
    "mode": "client",
    "scouting/multicast/enabled": False,
    "scouting/gossip/enabled": False,
    # How long we may be silent before the other side drops us; it must be announced by the silent side.
    "transport/link/tx/lease": 1000,
    "transport/link/tx/keep_alive": 4,
    "transport/shared_memory/enabled": False,
    # Microseconds; by default a message that cannot leave at once blocks its sender for 1 ms.
    "transport/link/tx/queue/congestion_control/drop/wait_before_drop": 0,
    "connect/timeout_ms": 2000,
    # The default waits up to 4 s between attempts, which made reconnecting as slow.
    "connect/retry": {"period_init_ms": 100, "period_max_ms": 500, "period_increase_factor": 1.5},
}


def client_config(address: str, file: Path | None) -> tuple[zenoh.Config, str]:
    """Return the configuration of a client's session and the endpoint that it connects to.

    ``file`` may hold what a network needs (certificates). It does not change how the client connects, nor how
    soon the other side notices its silence. Raises UsageError and FileError.
    """
    found = parse_address(address, PORT)
    if found is None:
        raise UsageError(
            f"--robot {address}: expected PROTOCOL/HOST[:PORT], for example tcp/192.168.1.20:{PORT}"
        )
    if not found.connectable:
        raise UsageError(f"--robot {address}: expected a port from 1 to {MAX_PORT}")
    config, endpoint = read_config(file), str(found)
    require_valid(config, "connect", file, datetime.now(UTC))
    for path, value in {**CLIENT, "connect/endpoints": [endpoint]}.items():
        config.insert_json5(path, json.dumps(value))
    return config, endpoint


def open_robot(endpoint: str, file: Path | None = None) -> zenoh.Session:
    """Open a session with the Zenoh router of a ROS 2 robot. Raises NoRobot, UsageError and FileError."""
    config, _ = client_config(endpoint, file)
    try:
        return zenoh.open(config)
    except zenoh.ZError as error:
        found = listener_at(endpoint)
        what_to_do = {
            Listener.NOTHING: "; start zenoh-bridge-ros2dds or rmw_zenohd on the robot",
            Listener.ZENOH: " (--base-zenoh-config)",
        }.get(found, f" ({reason(error)})" if found is Listener.OTHER else "")
        raise NoRobot(f"{endpoint}: no Zenoh router answers there: {found}{what_to_do}") from error


def read_config(file: Path | None) -> zenoh.Config:
    """Return the settings in a file, or Zenoh's own. Raises FileError."""
    if file is None:
        return zenoh.Config()
    if _nesting(read_text(file)) > MAX_DEPTH:
        raise FileError(
            f"{file}: not a Zenoh configuration: more than {MAX_DEPTH} lists or objects in each other"
        )
    try:
        return zenoh.Config.from_file(str(file))
    except zenoh.ZError as error:
        raise FileError(f"{file}: not a Zenoh configuration: {reason(error)}") from error


def _nesting(text: str) -> int:
    """Return the deepest nesting of brackets; Zenoh's reader ends the process on one of 100,000."""
    steps = (1 if mark in "[{" else -1 for mark in re.findall(r"[][{}]", text))
    return max(accumulate(steps), default=0)


def reason(error: zenoh.ZError) -> str:
    """Return Zenoh's reason without the places in its source."""
    return str(error).split(" at /", maxsplit=1)[0].splitlines()[0]
