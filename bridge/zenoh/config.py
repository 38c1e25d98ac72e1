"""Configuration of the bridge's Zenoh session: where it listens, and authentication beyond this machine."""

import ipaddress
import json
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import zenoh

from rover_ncp.core.errors import FileError, UsageError
from rover_ncp.wire.address import parse_address
from rover_ncp.wire.certificate_dates import require_valid
from rover_ncp.wire.zenoh import PORT, read_config

LISTEN = "tcp/127.0.0.1:7447"
"""Zenoh's own port, on this machine alone."""

_SETTINGS: dict[str, Any] = {
    "mode": "router",
    # It would cost half a second at the start; the bridge looks for no other router.
    "scouting/delay": 0,
    "scouting/multicast/enabled": False,
    "scouting/gossip/enabled": False,
    # Peers take the lease of this session from here, not from their own settings.
    "transport/link/tx/lease": 1000,
    "transport/link/tx/keep_alive": 4,
    # The longest message we read has 4 kB, the longest that passes through us hardly more.
    "transport/link/rx/max_message_size": 1 << 20,
    # No peer of ours uses it, and with a full /dev/shm the session would not open.
    "transport/shared_memory/enabled": False,
    # Publishing never blocks: by default it waits 1 ms before it drops a message that cannot leave at once.
    "transport/link/tx/queue/congestion_control/drop/wait_before_drop": 0,
    # Microseconds that an answer to a query may wait for a peer that takes no data, instead of 5 s: the loop
    # answers. Then Zenoh ends the session with that peer.
    "transport/link/tx/queue/congestion_control/block/wait_before_close": 20_000,
}
_MTLS = "transport/link/tls/enable_mtls"
_LOCAL_PROTOCOLS = frozenset({"unixsock-stream", "unixpipe"})
_ENCRYPTED_PROTOCOLS = frozenset({"tls", "quic"})


def configured(
    listen: str | None, file: Path | None, insecure: bool, command_key: str
) -> tuple[zenoh.Config, list[str]]:
    """Return the session's settings and where it listens: the option, else the file, else our default.

    Raises FileError for a bad file, for certificates that are not valid now and for access rules that let
    no user send commands on ``command_key``. Raises UsageError for a bad endpoint or, unless ``insecure``,
    for one beyond this machine without authentication.
    """
    settings = read_config(file)
    endpoints = [listen] if listen else _endpoints(settings)
    for path, value in _SETTINGS.items():
        settings.insert_json5(path, json.dumps(value))
    try:
        settings.insert_json5("listen/endpoints", json.dumps(endpoints))
    except zenoh.ZError as error:
        raise UsageError(f"--listen {endpoints[0]}: expected PROTOCOL/HOST:PORT, like {LISTEN}") from error
    if not insecure:
        _require_authentication(settings, endpoints)
    require_valid(settings, "listen", file, datetime.now(UTC))
    _require_access(settings, file, command_key)
    if any_port(endpoints):
        settings.insert_json5("adminspace/enabled", "true")  # the port is shown nowhere else
    return settings, endpoints


def any_port(endpoints: list[str]) -> bool:
    """Return whether the system is to choose the port of the first endpoint."""
    return endpoints[0].partition("#")[0].endswith(":0")


def _endpoints(settings: zenoh.Config) -> list[str]:
    """Return where a configuration listens. Zenoh's default is every interface, ours this machine alone."""
    found = json.loads(settings.get_json("listen/endpoints"))
    if found == json.loads(zenoh.Config().get_json("listen/endpoints")):
        return [LISTEN]
    return _of_router(found) or [LISTEN]


def _of_router(endpoints: Any) -> list[str]:
    if isinstance(endpoints, dict):  # one list for each mode
        endpoints = endpoints.get("router")
    return [str(item) for item in endpoints or []]


def _require_authentication(settings: zenoh.Config, endpoints: list[str]) -> None:
    """Raise UsageError if a client beyond this machine could drive without authentication.

    A router that we connect to brings all who are connected to it.
    """
    connects = _of_router(json.loads(settings.get_json("connect/endpoints")))
    open_ = [where for where in [*endpoints, *connects] if not _local(where)]
    mutual = json.loads(settings.get_json(_MTLS)) is True
    if not open_ or (mutual and all(where.partition("/")[0] in _ENCRYPTED_PROTOCOLS for where in open_)):
        return
    raise UsageError(
        f"{open_[0]}: any client that reaches it could drive the rover; make keys with 'rover-ncp keys' and "
        "give --zenoh-config, or give --insecure"
    )


def _require_access(settings: zenoh.Config, file: Path | None, command_key: str) -> None:
    """Raise FileError if access rules let no user send commands, as those made for another namespace."""
    access = json.loads(settings.get_json("access_control"))
    if not access["enabled"] or access["default_permission"] != "deny":
        return
    allowed = [
        name
        for rule in access["rules"] or []
        if rule["permission"] == "allow" and "put" in rule["messages"]
        for name in rule["key_exprs"]
    ]
    if not any(zenoh.KeyExpr(name).includes(zenoh.KeyExpr(command_key)) for name in allowed):
        found = sorted({name for name in allowed if name.endswith("cmd_vel")})
        raise FileError(
            f"{file}: its access rules let no user publish {command_key}, they are for "
            f"{', '.join(found) or 'no commands'}: give the bridge and 'rover-ncp keys' the same --namespace"
        )


def _local(endpoint: str) -> bool:
    """Whether only this machine can reach the endpoint."""
    if endpoint.partition("/")[0] in _LOCAL_PROTOCOLS:
        return True
    address = parse_address(endpoint, PORT)
    if address is None:
        return False
    try:
        return ipaddress.ip_address(address.host).is_loopback
    except ValueError:
        return address.host == "localhost"
