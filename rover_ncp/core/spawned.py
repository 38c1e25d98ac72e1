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
    """Let a Ctrl-C wait until the end of the block, and keep it from processes spawned within for good.

    A terminal sends it to the whole group, and the parent alone decides. They inherit the blocked signal, so
    it cannot hit them even while their interpreter starts. Blocking it here does not hold it back: any
    thread of a library takes it instead, so it is also noted and passed on.
    """
    # The tracker unblocks SIGINT while it starts, so it has to start before we block it.
    resource_tracker.ensure_running()
    held: list[int] = []
    is_main = threading.current_thread() is threading.main_thread()
    handler = signal.signal(signal.SIGINT, lambda number, _: held.append(number)) if is_main else None
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        if is_main:
            signal.signal(signal.SIGINT, handler)
    if held and callable(handler):
        handler(signal.SIGINT, None)
