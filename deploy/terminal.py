"""A terminal that delivers single keys at once; its settings are always restored."""

import codecs
import contextlib
import os
import select
import sys
import termios
from types import TracebackType
from typing import Self

from rover_ncp.core.errors import UsageError

READ_BYTES = 1024
BRACKETED_PASTE, NO_BRACKETED_PASTE = b"\x1b[?2004h", b"\x1b[?2004l"
"""Makes a terminal mark the beginning and the end of pasted text."""
_INPUT, _LOCAL, _CHARACTERS = 0, 3, 6


class Terminal:
    """Standard input as a keyboard, inside a ``with`` block. Raises UsageError when it is no terminal.

    Ctrl-C stays a signal. Ctrl-Z and Ctrl-S are keys: a stopped process and a stopped screen both leave a
    rover without its driver.
    """

    def __init__(self) -> None:
        # Bytes that are no UTF-8 stay distinct: some of them begin a sequence.
        self._decoder = codecs.getincrementaldecoder("utf-8")("surrogateescape")
        self._fd = sys.stdin.fileno() if sys.stdin is not None else -1
        if self._fd < 0 or not os.isatty(self._fd):
            raise UsageError("teleop reads keys: expected a terminal as standard input")

    def __enter__(self) -> Self:
        self._before = termios.tcgetattr(self._fd)
        settings = termios.tcgetattr(self._fd)
        settings[_INPUT] &= ~(termios.IXON | termios.IXOFF)
        settings[_LOCAL] &= ~(termios.ICANON | termios.ECHO)
        # Neither may wait: `read` does, with a limit.
        settings[_CHARACTERS][termios.VMIN] = settings[_CHARACTERS][termios.VTIME] = 0
        settings[_CHARACTERS][termios.VSUSP] = os.fpathconf(self._fd, "PC_VDISABLE").to_bytes()
        # TCSAFLUSH would wait until the terminal has written all output, which a stopped one never does.
        self.discard()
        termios.tcsetattr(self._fd, termios.TCSANOW, settings)
        self._send(BRACKETED_PASTE)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        # A closed terminal cannot be set back, and need not be. There is no wait for one that is stuck.
        self._send(NO_BRACKETED_PASTE)
        with contextlib.suppress(termios.error):
            termios.tcflush(self._fd, termios.TCIFLUSH)
            termios.tcsetattr(self._fd, termios.TCSANOW, self._before)

    def read(self, timeout_s: float) -> str | None:
        """Return the keys that came; wait for the first at most so long. None once the terminal is gone."""
        ready, _, _ = select.select([self._fd], [], [], timeout_s)
        if not ready:
            return ""
        try:
            data = os.read(self._fd, READ_BYTES)
        except OSError:
            return None
        return self._decoder.decode(data) if data else None

    def discard(self) -> None:
        """Discard unread keys."""
        termios.tcflush(self._fd, termios.TCIFLUSH)

    def _send(self, data: bytes) -> None:
        """Write to the terminal, unless it takes nothing at once."""
        with contextlib.suppress(OSError):
            fd = os.open(os.ttyname(self._fd), os.O_WRONLY | os.O_NONBLOCK | os.O_NOCTTY)
            try:
                os.write(fd, data)
            finally:
                os.close(fd)
