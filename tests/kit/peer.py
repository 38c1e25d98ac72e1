"""Zenoh sessions with a thread, for programs that act as a driver, a localiser or a bridge."""

import threading
from typing import Any, Self

import zenoh

from rover_ncp.core.process import ClosedAtExit


class Peer(ClosedAtExit):
    """A Zenoh session and a thread that runs `run`, from `start` or the beginning of the ``with`` block on.

    `close`, or the end of the block, sets ``closing`` and waits for the thread.
    """

    def __init__(self, config: zenoh.Config) -> None:
        config.insert_json5("connect/timeout_ms", "20000")  # as long as a busy machine may take
        self.session = zenoh.open(config)
        self.closing = threading.Event()
        self._thread = threading.Thread(target=self.run, name=type(self).__name__, daemon=True)

    def run(self) -> None:
        """Do the peer's work until ``closing`` is set."""
        raise NotImplementedError

    def start(self) -> Self:
        """Start the thread."""
        self._thread.start()
        return self

    def close(self) -> None:
        """End the thread and the session."""
        self.closing.set()
        if self._thread.is_alive():
            self._thread.join()
        session: Any = self.session
        session.close()

    def __enter__(self) -> Self:
        return self.start()
