"""Teams on the workers of a Dask cluster: the agents travel, the results are those of one machine.

A round's groups are tasks that depend on nothing but what they carry, so whatever worker runs one, and
however often, the same bits come back: Dask gives the tasks of a worker that died to another one. A worker
builds its team once and keeps it for the rounds that follow.

Anyone who reaches a Dask scheduler can run code on its workers: it belongs on a trusted network.
"""

import logging
import pickle
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, Self

from rover_ncp.core.errors import UsageError
from sim.learn.record import made_with
from sim.learn.team import AgentState, Plan, Rounds, Team
from sim.learn.workers import WorkerDied, split

CONNECT_S = 10.0
"""How long a scheduler has to answer, and then a first worker to be there."""
RETRIES = 1000
"""Workers that may die on one task; Dask's own three would end a run on machines that come and go."""

_teams: dict[bytes, Team] = {}
# A team serves one thread at a time; a worker may have several.
_one_team = threading.Lock()


class ClusterLost(WorkerDied):
    """The scheduler of a cluster went away."""


def connect(address: str) -> Any:
    """Return a client of a scheduler that has a worker. Raises UsageError."""
    from distributed import Client

    client: Any = Client

    # Its own complaints about a connection that ends come as tracebacks; ours are one line.
    for name in ("distributed", "distributed.core", "distributed.client"):
        logging.getLogger(name).setLevel(logging.CRITICAL)
    try:
        found = client(address, timeout=CONNECT_S, set_as_default=False)
    except (OSError, ValueError, TypeError) as error:
        raise UsageError(f"no Dask scheduler answers at {address}") from error
    try:
        found.wait_for_workers(1, timeout=CONNECT_S)
    except TimeoutError as error:
        found.close()
        raise UsageError(f"the Dask scheduler at {address} has no workers") from error
    return found


@contextmanager
def told_plainly(address: str) -> Iterator[None]:
    """Raise UsageError for workers that lack this project, ClusterLost for a scheduler that went away."""
    from concurrent.futures import CancelledError

    from distributed import KilledWorker
    from distributed.comm.core import CommClosedError

    try:
        yield
    except (ModuleNotFoundError, pickle.PickleError) as error:
        raise UsageError(f"the workers at {address} lack rover-ncp: {error}") from error
    except (CancelledError, CommClosedError, KilledWorker, OSError) as error:
        raise ClusterLost(f"the Dask cluster at {address} is gone: {error}") from error


def versions() -> dict[str, str]:
    """Return the versions that must be the same everywhere; a commit shows only where there is git."""
    return {name: version for name, version in made_with().items() if name != "commit"}


def require_versions(wanted: Mapping[str, str]) -> None:
    """On a worker, raise UsageError if its versions are not those wanted."""
    if versions() != wanted:
        raise UsageError(f"a worker has {versions()}, this machine {dict(wanted)}: results would differ")


class DaskCluster:
    """Teams on a cluster's workers. A context manager: leaving it takes back what still runs there."""

    def __init__(self, plan: Plan, address: str) -> None:
        self.address = address
        self._plan = pickle.dumps(plan)
        self._client: Any = None

    def __enter__(self) -> Self:
        self._client = connect(self.address)
        return self

    def __exit__(self, *error: object) -> None:
        self._client.close()

    @property
    def count(self) -> int:
        """How many workers there are now, at least 1: those that died may come back."""
        return max(len(self._client.scheduler_info(n_workers=-1)["workers"]), 1)

    def rounds(self, agents: Sequence[AgentState], targets: Sequence[int]) -> Rounds:
        """Give all agents after each of these numbers of candidates.

        Raises UsageError for workers that cannot give the same results, and ClusterLost.
        """
        for target in targets:
            agents = self._advance(split(agents, self.count), target)
            yield list(agents)

    def _advance(self, groups: Sequence[Sequence[AgentState]], iterations: int) -> list[AgentState]:
        wanted = versions()
        with told_plainly(self.address):
            tasks = [
                self._client.submit(
                    _advance, self._plan, list(group), iterations, wanted, pure=False, retries=RETRIES
                )
                for group in groups
            ]
            answers = self._client.gather(tasks)
        return [agent for answer in answers for agent in answer]


def _advance(
    plan: bytes, group: Sequence[AgentState], iterations: int, wanted: Mapping[str, str]
) -> list[AgentState]:
    """Advance a group, on a worker."""
    require_versions(wanted)
    with _one_team:
        if plan not in _teams:
            _teams.clear()
            _teams[plan] = Team(pickle.loads(plan))
        return _teams[plan].advance(group, iterations)
