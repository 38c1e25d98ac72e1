"""Spawned processes: they end with their parent, and a terminal's Ctrl-C reaches the parent alone."""

import multiprocessing
import os
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing import resource_tracker


def end_with_parent() -> None:
    """End this spawned process when its parent ends, also when the parent is killed."""

    def wait() -> None:
        if (parent := multiprocessing.parent_process()) is not None:
            parent.join()
            os._exit(1)

    threading.Thread(target=wait, daemon=True).start()


@contextmanager
def starting_processes() -> Iterator[None]:
    """Keep Ctrl-C, which a terminal sends to the whole group, from processes that are spawned within.

    The signal is blocked, which they inherit. One that arrives meanwhile is delivered at the end.
    """
    resource_tracker.ensure_running()  # its start within would unblock the signal
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
