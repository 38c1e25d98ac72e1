"""The mock's TCP server: one client at a time, in real time."""

import errno
import selectors
import socket
import time
from contextlib import suppress

from rover_ncp.core.errors import PortInUse, UsageError
from rover_ncp.wire.address import MAX_PORT, parse_address
from sim.base.firmware import Firmware
from sim.mock.real_time import RealTimeLoop

CHUNK_BYTES = 4096

BACKLOG_BYTES = 1 << 16
"""A client that does not read loses what is beyond this, as on a serial line."""


def parse_listen(text: str, option: str = "--listen") -> tuple[str, int]:
    """Read ``HOST:PORT``; port 0 takes a free one. Raises UsageError."""
    address = parse_address(f"tcp/{text}", MAX_PORT + 1)
    if address is None or address.settings or address.port > MAX_PORT:
        raise UsageError(f"{option} {text}: expected HOST:PORT, for example 127.0.0.1:8101")
    return address.host, address.port


class Server(RealTimeLoop):
    """Serves a firmware, whose clock is the machine's monotonic clock, on TCP.

    Raises PortInUse, or UsageError for an address that cannot be listened on.
    """

    def __init__(self, host: str, port: int, firmware: Firmware) -> None:
        super().__init__(firmware)
        self._listener = _listen(host, port)
        name = self._listener.getsockname()
        self.host, self.port = str(name[0]), int(name[1])
        self.firmware = firmware
        self._client: socket.socket | None = None
        self._backlog = bytearray()
        self.selector.register(self._listener, selectors.EVENT_READ, self._accept)

    def close(self) -> None:
        """Hang up and close everything."""
        self._hang_up()
        self._listener.close()
        super().close()

    def _accept(self) -> None:
        with suppress(OSError):
            client, _ = self._listener.accept()
            self._receive()  # the selector may report a new client before the end of the old one
            if self._client is not None:
                client.close()
                return
            client.setblocking(False)
            client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._client = client
            self._backlog.clear()
            self.firmware.line_changed()
            self.selector.register(client, selectors.EVENT_READ, self._receive)

    def _receive(self) -> None:
        if self._client is None:
            return
        try:
            data = self._client.recv(CHUNK_BYTES)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if not data:
            self._hang_up()
            return
        self.heard_s = time.monotonic()
        self.firmware.receive(data, self.heard_s)

    def send(self) -> None:
        """Send what the firmware has for the client."""
        data = self.firmware.data_to_send()
        if self._client is None:
            return
        if len(self._backlog) + len(data) <= BACKLOG_BYTES:
            self._backlog += data
        if not self._backlog:
            return
        try:
            sent = self._client.send(self._backlog)
        except BlockingIOError:
            return
        except OSError:
            self._hang_up()
            return
        del self._backlog[:sent]

    def _hang_up(self) -> None:
        if self._client is not None:
            self.selector.unregister(self._client)
            self._client.close()
            self._client = None


def _listen(host: str, port: int) -> socket.socket:
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    listener = socket.socket(family, socket.SOCK_STREAM)
    try:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind((host, port))
        listener.listen()
        listener.setblocking(False)
    except OSError as error:
        listener.close()
        if error.errno == errno.EADDRINUSE:
            raise PortInUse(f"--listen {host}:{port}: another process listens there") from error
        raise UsageError(f"--listen {host}:{port}: {error.strerror or error}") from error
    return listener
