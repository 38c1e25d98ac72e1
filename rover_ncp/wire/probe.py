"""Find out what listens where no Zenoh session could be opened: Zenoh reports each cause as a timeout.

A router answers the first message of a session (InitSyn) of its own protocol version with an InitAck, and one
of another version with the end of the session. Form from Zenoh's protocol definition (facts only).
"""

import socket
import struct
from enum import StrEnum

from rover_ncp.wire.address import parse_address

PROBE_S = 1.0
OLD_VERSION, VERSION = 8, 9
"""Protocol versions of Zenoh 0.10 and 0.11, and of Zenoh 1."""
_INIT, _HAS_SIZES, _IS_ACK = 0x01, 0x40, 0x20
_CLIENT = 0b10
_ID = b"rover-ncp probe."


class Listener(StrEnum):
    """What listens at an address, in words."""

    NOTHING = "nothing listens there"
    OLD_ZENOH = "a Zenoh before version 1 listens there, such as 0.11; update it there to 1.0 or later"
    ZENOH = "a Zenoh router listens there and accepts no session: it may want a certificate or a password"
    OTHER = "what listens there did not answer as a Zenoh router"


def listener_at(endpoint: str) -> Listener:
    """Return what listens at a Zenoh endpoint; a version can be told of TCP alone."""
    address = parse_address(endpoint, 0)
    if address is None or address.protocol not in {"tcp", "tls"}:
        return Listener.OTHER
    try:
        socket.create_connection((address.host, address.port), PROBE_S).close()
    except OSError:
        return Listener.NOTHING
    if address.protocol == "tcp":
        for version, found in ((OLD_VERSION, Listener.OLD_ZENOH), (VERSION, Listener.ZENOH)):
            if _speaks(address.host, address.port, version):
                return found
    return Listener.OTHER


def _speaks(host: str, port: int, version: int) -> bool:
    """Whether a router answers to the first message of a session in this protocol version."""
    head = bytes([_INIT | _HAS_SIZES, version, (len(_ID) - 1) << 4 | _CLIENT])
    message = head + _ID + struct.pack("<BH", 0x0A, 65535)
    try:
        with socket.create_connection((host, port), PROBE_S) as line:
            line.settimeout(PROBE_S)
            line.sendall(struct.pack("<H", len(message)) + message)
            answer = line.recv(4)
    except OSError:
        return False
    is_ack = len(answer) == 4 and answer[2] & 0x1F == _INIT and bool(answer[2] & _IS_ACK)
    return is_ack and answer[3] == version
