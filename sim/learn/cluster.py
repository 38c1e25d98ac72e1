"""Workers on a Dask cluster, with the interface of `ProcessPool`.

A task depends on nothing but what it carries, so Dask may give the tasks of a worker that died to another
one. Every worker must have the same versions of what decides a result.

A cluster is trusted like this machine. Anyone who reaches a Dask scheduler can run code on its workers, and
any worker can run code here: Dask unpickles its answers.
"""

import logging
import pickle
import threading
from collections.abc import Callable, Mapping
from concurrent.futures import CancelledError, Future
from types import TracebackType
from typing import Any, Self

from rover_ncp.core.console import printable
from rover_ncp.core.errors import UsageError
from sim.learn.record import versions
from sim.learn.workers import WorkerDied

_LOGGER = logging.getLogger(__name__)
CONNECT_S = 10.0
"""How long a scheduler has to answer, and then a first worker to be there."""
_LOOK_S = 5.0
"""Time between two looks for workers."""
_RETRIES = 1000
"""Workers that may die on one task; Dask's own three would end a run on machines that come and go."""

# A worker may have several threads, but evaluators serve one at a time.
_one_task = threading.Lock()


class ClusterLost(WorkerDied):
    """The scheduler of a cluster went away."""


class DaskCluster:
    """The workers of a Dask cluster. Leaving its context cancels what still runs there.

    Raises UsageError for a scheduler or workers that are missing or unsuitable, and ClusterLost.
    """

    def __init__(self, address: str) -> None:
        self._address = address
        self._closed = threading.Event()

    def __enter__(self) -> Self:
        from distributed import Client

        client: Any = Client
        # Dask reports a connection that ends with tracebacks; this command does it in one line.
        for name in ("distributed", "distributed.core", "distributed.client"):
            logging.getLogger(name).setLevel(logging.CRITICAL)
        try:
            self._client = client(self._address, timeout=CONNECT_S, set_as_default=False)
        except (OSError, ValueError, TypeError) as error:
            raise UsageError(f"no Dask scheduler answers at {self._address}") from error
        try:
            self._client.wait_for_workers(1, timeout=CONNECT_S)
        except TimeoutError as error:
            self._client.close()
            raise UsageError(f"the Dask scheduler at {self._address} has no workers") from error
        self._executor = self._client.get_executor(pure=False, retries=_RETRIES)
        threading.Thread(target=self._watch, name="dask-workers", daemon=True).start()
        return self

    def _watch(self) -> None:
        """Warn when the last worker is gone: Dask waits for the next one and says nothing."""
        warned = False
        while not self._closed.wait(_LOOK_S):
            try:
                empty = not self._workers()
            except Exception:  # the scheduler is gone, which the calls report
                return
            if empty and not warned:
                words = f"no worker is left at {self._address}; waiting for one, and Ctrl-C ends the training"
                _LOGGER.warning("%s", printable(words))
            warned = empty

    def _workers(self) -> int:
        return len(self._client.scheduler_info(n_workers=-1)["workers"])

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        from distributed import KilledWorker
        from distributed.comm.core import CommClosedError

        self._closed.set()
        self._client.close()
        if isinstance(error, ModuleNotFoundError | pickle.PickleError):
            raise UsageError(f"the workers at {self._address} lack rover-ncp: {error}") from error
        if isinstance(error, CancelledError | CommClosedError | KilledWorker):
            raise ClusterLost(f"the Dask cluster at {self._address} is gone: {error}") from error

    @property
    def count(self) -> int:
        """How many workers there are now, at least 1: those that died may come back."""
        return max(self._workers(), 1)

    def submit(self, function: Callable[..., Any], /, *arguments: Any) -> Future[Any]:
        """Call a function in a worker."""
        future: Future[Any] = self._executor.submit(_call, versions(), function, arguments)
        return future


def _call(wanted: Mapping[str, str], function: Callable[..., Any], arguments: tuple[Any, ...]) -> Any:
    """Call a function, on a worker."""
    if versions() != wanted:
        raise UsageError(f"a worker has {versions()}, this machine {dict(wanted)}: results would differ")
    with _one_task:
        return function(*arguments)
