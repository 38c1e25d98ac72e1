"""The line to the base, read by a thread of its own that also opens it again when it broke.

Reading and opening block, so they are the thread's; writing and closing are the loop's. What the thread
meets, errors included, goes to the inbox.
"""

import threading

from bridge.inbox import Broken, Crashed, Inbox, Opened, Received
from bridge.transport import Transport, open_transport
from rover_ncp.core.errors import NoRobot

__all__ = ["Line"]

READ_S = 0.1
RETRY_S = 1.0
"""Between two attempts to open a line."""


class Line:
    """Opens at once: raises UsageError for an endpoint of no known form, NoRobot when nobody is there."""

    def __init__(self, endpoint: str, inbox: Inbox) -> None:
        self.endpoint = endpoint
        self._inbox = inbox
        self._current: Transport | None = None
        self._all: list[Transport] = []
        self._failed: NoRobot | None = None
        """Why writing failed; the reader looks here, for it may hear nothing of it."""
        self._closing = threading.Event()
        first = self._open()
        self._thread = threading.Thread(target=self._run, args=(first,), name="base-line", daemon=True)
        self._thread.start()

    @property
    def bytes_in(self) -> int:
        """Bytes from the base, over all lines so far."""
        return sum(transport.bytes_in for transport in self._all)

    @property
    def bytes_out(self) -> int:
        """Bytes to the base, over all lines so far."""
        return sum(transport.bytes_out for transport in self._all)

    def use(self, transport: Transport) -> None:
        """Write to this line from now on; the loop says so when it knows of it."""
        self._current = transport

    def drop(self) -> None:
        """Let go of a broken line."""
        if self._current is not None:
            self._current.close()
            self._current = None

    def write(self, data: bytes) -> None:
        """Send bytes to the base; without a line they are lost. A failure arrives as `Broken`."""
        if self._current is not None and self._failed is None and data:
            try:
                self._current.write(data)
            except NoRobot as error:
                self._failed = error

    @property
    def baudrate(self) -> int | None:
        """The rate the line runs at; None without a line, or on one that has no rate."""
        return None if self._current is None else self._current.baudrate

    def set_baudrate(self, baudrate: int) -> None:
        """Let the line run at another rate. A failure arrives as `Broken`."""
        if self._current is not None and self._failed is None:
            try:
                self._current.set_baudrate(baudrate)
            except NoRobot as error:
                self._failed = error

    def close(self) -> None:
        """End the thread, then all lines, once what was written has gone out."""
        self._closing.set()
        self._thread.join(2 * READ_S)
        for transport in self._all:  # also one that the loop never got to know of
            transport.close()

    def _open(self) -> Transport:
        transport = open_transport(self.endpoint)
        self._all.append(transport)
        self._inbox.put(Opened(transport))
        return transport

    def _run(self, first: Transport) -> None:
        transport: Transport | None = first
        try:
            while not self._closing.is_set():
                try:
                    if transport is None:
                        self._failed = None
                        transport = self._open()
                    data = transport.read(READ_S)
                    if self._failed is not None:
                        raise self._failed
                except NoRobot as error:
                    if not self._closing.is_set():
                        self._inbox.put(Broken(error))
                    transport = None
                    self._closing.wait(RETRY_S)
                else:
                    if data:
                        self._inbox.put(Received(data))
        except BaseException as error:
            self._inbox.put(Crashed(error))
