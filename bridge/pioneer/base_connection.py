"""The line to the base; its own thread reads it and opens another when it fails or nothing arrives.

Opening, reading and closing block, so the thread does them; the loop only writes. The thread puts all bytes
and errors into the inbox. It closes a line before it opens the next, because a base takes one client at a
time, and after the loop has dropped the line, because the loop may be writing. Bytes that a line has not
delivered by then are lost: later they would be old setpoints.
"""

import threading
from collections.abc import Callable
from dataclasses import dataclass

from bridge.inbox import Inbox, ThreadError
from bridge.pioneer.transport import Transport, open_transport
from rover_ncp.core.errors import NoRobot

READ_S = 0.1
RETRY_S, MAX_RETRY_S = 0.1, 0.5
"""Wait before opening a line again. It doubles with each line on which nothing arrives, up to the maximum."""


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
