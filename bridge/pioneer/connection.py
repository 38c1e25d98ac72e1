"""The line to a Pioneer, over TCP or serial: all input and output of the ARCOS side.

Opening, reading and closing block, so `BaseConnection` does them in a thread of its own; the bridge's loop
only writes. The thread puts all bytes and errors into the inbox. It opens another line when one fails or
nothing arrives, but closes the old one first, because a base takes one client at a time. It closes a line
after the loop has dropped it, because the loop may be writing. Bytes that a line has not delivered by then
are lost: later they would be old setpoints.

A line, a `Transport`, carries bytes in order, nothing more. Each of its failures is a NoRobot that names the
line and the reason.
"""

import errno
import fcntl
import os
import select
import socket
import struct
import sys
import termios
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass

import serial

from bridge.inbox import Inbox, ThreadError
from rover_ncp.core.errors import NoRobot, UsageError
from rover_ncp.wire.address import parse_address

DEFAULT_PORT = 8101
"""TCP port of a base in ARIA, p2os and AMRISim."""
DEFAULT_BAUD = 9600
"""The base's FLASH default."""
CONNECT_TIMEOUT_S = 5.0
BACKLOG_S = 0.5
"""A line is broken if bytes wait for longer than this in it: later commands would only arrive late."""
BITS_PER_BYTE = 10
"""On a serial line: start bit, 8 data bits, stop bit."""
LINGER_S = 0.3
"""How long closing waits for the base to hang up too."""
ABORT = struct.pack("ii", 1, 0)
"""SO_LINGER: close by a reset, and drop undelivered bytes."""
CHUNK_BYTES = 4096
READ_S = 0.1
RETRY_S, MAX_RETRY_S = 0.1, 0.5
"""Wait before opening a line again. It doubles with each line on which nothing arrives, up to the maximum."""

_ERRORS = (OSError, ValueError, TypeError)
"""Errors of sockets and of pyserial, whose SerialException is an OSError."""
_FORM = "expected tcp/HOST[:8101] or serial//dev/ttyUSB0[#baudrate=9600]"


class Transport(ABC):
    """An open line. One thread may read while another writes."""

    hung_up: str
    """Reason for the end of a line that has not failed."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.bytes_out = 0
        self.baudrate: int | None = None
        """The rate it runs at; None on a line that has none."""

    @abstractmethod
    def fileno(self) -> int:
        """Return the descriptor, which never waits."""

    def set_baudrate(self, baudrate: int) -> None:  # noqa: B027
        """Run at another rate from now on, if the line has one. Raises NoRobot when the line is gone."""

    @abstractmethod
    def close(self) -> None:
        """Close the line after all written bytes have been sent. Never fails."""

    @abstractmethod
    def abort(self) -> None:
        """Close the line at once; written bytes that have not been delivered are lost. Never fails."""

    @abstractmethod
    def _stuck(self) -> bool:
        """Return whether written bytes have waited in the line for longer than `BACKLOG_S`."""

    def read(self, timeout: float) -> bytes:
        """Return what has arrived, waiting up to ``timeout`` seconds for the first byte; empty if none came.

        Raises NoRobot when the line is gone.
        """
        try:
            readable, _, _ = select.select([self], [], [], timeout)
            if not readable:
                return b""
            data = os.read(self.fileno(), CHUNK_BYTES)
        except BlockingIOError:  # the bytes that were announced had a wrong checksum
            return b""
        except _ERRORS as error:
            raise self._gone(_reason(error)) from error
        if not data:
            raise self._gone(self.hung_up)
        return data

    def write(self, data: bytes) -> None:
        """Send all of ``data`` without waiting. Raises NoRobot when the line is gone or has no room for it.

        Then part of it may have been sent.
        """
        try:
            sent = 0 if self._stuck() else os.write(self.fileno(), data)
        except BlockingIOError:
            sent = 0
        except _ERRORS as error:
            raise self._gone(_reason(error)) from error
        self.bytes_out += sent
        if sent < len(data):
            raise self._gone("the line takes no more bytes")

    def _gone(self, reason: object) -> NoRobot:
        return NoRobot(f"{self.name}: {reason}")


class TcpTransport(Transport):
    """A base behind a TCP port: a simulator, or a serial-to-ethernet converter on the robot."""

    hung_up = "the base closed the connection (it takes one client at a time)"

    def __init__(self, host: str, port: int) -> None:
        super().__init__(f"tcp/{host}:{port}")
        try:
            self._socket = socket.create_connection((host, port), timeout=CONNECT_TIMEOUT_S)
        except TimeoutError as error:
            raise self._gone(f"no answer within {CONNECT_TIMEOUT_S:.0f} s") from error
        except ConnectionRefusedError as error:
            raise self._gone("connection refused: nothing listens there") from error
        except (OSError, UnicodeError) as error:
            raise self._gone(getattr(error, "strerror", None) or error) from error
        # A command is a few bytes that must not wait for more.
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        # The control loop writes, and must not wait for room.
        self._socket.setblocking(False)
        self._acknowledged = 0
        """How many of the written bytes the far end has acknowledged."""
        self._advanced_s = 0.0
        """When a write last found that number grown, or no byte outstanding."""

    def fileno(self) -> int:
        return self._socket.fileno()

    def _stuck(self) -> bool:
        """Return whether bytes are outstanding and the far end has acknowledged none for `BACKLOG_S`.

        On a slow line that works, some bytes are always outstanding, but never the same ones for long.
        """
        now, outstanding = time.monotonic(), self._outstanding()
        acknowledged = self.bytes_out - outstanding
        if not outstanding or acknowledged > self._acknowledged:
            self._acknowledged, self._advanced_s = acknowledged, now
        return now - self._advanced_s > BACKLOG_S

    def _outstanding(self) -> int:
        """Return how many written bytes the far end has not acknowledged; 0 where only Linux counts them."""
        if sys.platform != "linux":
            return 0
        return int.from_bytes(fcntl.ioctl(self._socket, termios.TIOCOUTQ, bytes(4)), sys.byteorder)

    def close(self) -> None:
        with suppress(OSError, ValueError):
            self._socket.shutdown(socket.SHUT_WR)
            # Closing over unread bytes would reset the connection and might take our last command with it.
            deadline = time.monotonic() + LINGER_S
            while (left := deadline - time.monotonic()) > 0:
                readable, _, _ = select.select([self._socket], [], [], left)
                if not readable or not self._socket.recv(CHUNK_BYTES):
                    break
        with suppress(OSError):
            self._socket.close()

    def abort(self) -> None:
        with suppress(OSError):
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, ABORT)
        with suppress(OSError):
            self._socket.close()


class SerialTransport(Transport):
    """A base on a serial port; 8 data bits, no parity, 1 stop bit."""

    hung_up = "the port was unplugged, or another process reads it too"

    def __init__(self, port: str, baudrate: int = DEFAULT_BAUD) -> None:
        super().__init__(f"serial/{port}#baudrate={baudrate}")
        try:
            self._port = serial.Serial(port, baudrate=baudrate, timeout=0.0, exclusive=True)
        except _ERRORS as error:
            locked = getattr(_cause(error), "errno", None) in {errno.EAGAIN, errno.EBUSY}
            raise self._gone("another process uses it" if locked else _reason(error)) from error
        self.baudrate = baudrate

    def set_baudrate(self, baudrate: int) -> None:
        try:
            self._port.baudrate = baudrate
        except _ERRORS as error:
            raise self._gone(_reason(error)) from error
        self.baudrate = baudrate

    def fileno(self) -> int:
        return int(self._port.fileno())

    def _stuck(self) -> bool:
        return bool(self._port.out_waiting * BITS_PER_BYTE / self._port.baudrate > BACKLOG_S)

    def close(self) -> None:
        # The system sends what was written; waiting for it here could wait for ever on a dead port.
        with suppress(OSError):
            self._port.close()

    def abort(self) -> None:
        with suppress(*_ERRORS):
            self._port.reset_output_buffer()
        self.close()


def _reason(error: Exception) -> str:
    """Return pyserial's reason without its prose."""
    return str(getattr(_cause(error), "strerror", None) or error)


def _cause(error: Exception) -> BaseException:
    return error.__context__ if isinstance(error.__context__, OSError) else error


def open_transport(endpoint: str) -> Transport:
    """Open ``tcp/HOST[:PORT]`` or ``serial/PORT[#baudrate=N]`` (so ``serial//dev/ttyUSB0``).

    Raises UsageError for another form and NoRobot when nothing answers there.
    """
    found = parse_address(endpoint, DEFAULT_PORT)
    if found is not None and found.protocol == "tcp" and found.connectable and not found.settings:
        return TcpTransport(found.host, found.port)
    kind, _, address = endpoint.partition("/")
    address, _, settings = address.partition("#")
    # A URL of pyserial (socket://) cannot drop the bytes that it holds back.
    if kind == "serial" and address and "://" not in address:
        name, _, value = settings.partition("=")
        if not settings:
            return SerialTransport(address)
        if name == "baudrate" and value.isdigit() and int(value) > 0:
            return SerialTransport(address, int(value))
    raise UsageError(f"base {endpoint}: {_FORM}")


@dataclass(frozen=True)
class Opened:
    """A line is open; ``use`` it. ``baudrate`` is None for a line without a rate."""

    baudrate: int | None = None


@dataclass(frozen=True)
class Received:
    """Bytes from the base."""

    data: bytes


@dataclass(frozen=True)
class Broken:
    """The line, or the attempt to open it, failed; ``drop`` it."""

    error: NoRobot


class BaseConnection:
    """Opens at once: raises UsageError for an endpoint of no known form, NoRobot when nothing answers."""

    def __init__(self, endpoint: str, inbox: Inbox) -> None:
        self.endpoint = endpoint
        self._inbox = inbox
        self._current: Transport | None = None
        """The line that the loop writes to."""
        self._all: list[Transport] = []
        self._broken: NoRobot | None = None
        """Reason for giving up the line although reading does not fail."""
        self._closing, self._dropped = threading.Event(), threading.Event()
        first = self._open()
        self._thread = threading.Thread(target=self._run, args=(first,), name="base-line", daemon=True)
        self._thread.start()

    def use(self) -> None:
        """Write to the line that was opened last, from now on."""
        self._current = self._all[-1]

    def drop(self) -> None:
        """Answer `Broken`: write no more to that line. The thread then closes it and opens another."""
        self._current = None
        self._dropped.set()

    def reopen(self, reason: str) -> None:
        """Give up a line on which the base does not answer; `Broken` and `Opened` follow."""
        self._broken = NoRobot(f"{self.endpoint}: {reason}")

    def write(self, data: bytes) -> None:
        """Send bytes to the base; without a line they are lost. A failure arrives as `Broken`."""
        if data:
            self._try(lambda line: line.write(data))

    def set_baudrate(self, baudrate: int) -> None:
        """Let the line run at another rate. A failure arrives as `Broken`."""
        self._try(lambda line: line.set_baudrate(baudrate))

    def close(self) -> None:
        """End the thread, then all lines, once what was written has gone out.

        A line that did not take the last zeros must not deliver the setpoints before them later.
        """
        failed = self._broken is not None
        self._closing.set()
        self._dropped.set()
        self._thread.join(2 * READ_S)
        for transport in self._all:  # also a line that the loop did not use yet
            if failed:
                transport.abort()
            else:
                transport.close()

    def _try(self, action: Callable[[Transport], None]) -> None:
        if self._current is None:
            return
        try:
            action(self._current)
        except NoRobot as error:
            self._current, self._broken = None, error

    def _open(self) -> Transport:
        transport = open_transport(self.endpoint)
        self._all.append(transport)
        self._inbox.put(Opened(transport.baudrate))
        return transport

    def _run(self, first: Transport) -> None:
        transport: Transport | None = first
        wait_s = RETRY_S
        try:
            while not self._closing.is_set():
                try:
                    if transport is None:
                        transport = self._open()
                        if self._closing.is_set():  # `close` may have stopped waiting for this line
                            transport.abort()
                            return
                    data = transport.read(READ_S)
                    if self._broken is not None:
                        raise self._broken
                except Exception as error:
                    reason = error if isinstance(error, NoRobot) else NoRobot(f"{self.endpoint}: {error}")
                    self._give_up(transport, reason)
                    transport = None
                    self._closing.wait(wait_s)
                    wait_s = min(2 * wait_s, MAX_RETRY_S)
                else:
                    if data:
                        self._inbox.put(Received(data))
                        wait_s = RETRY_S
        except BaseException as error:
            self._inbox.put(ThreadError(error))

    def _give_up(self, transport: Transport | None, error: NoRobot) -> None:
        """Report a line that failed, or could not be opened, and close it once the loop has dropped it."""
        if self._closing.is_set():
            return
        self._inbox.put(Broken(error))
        self._dropped.wait()
        self._dropped.clear()
        self._broken = None
        if transport is not None and not self._closing.is_set():
            transport.abort()
            self._all.remove(transport)
