"""Training from settings to files: the ensemble, its engine and its folder brought together."""

import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import NamedTuple

from rover_ncp.circuit.policy import Policy
from rover_ncp.core.errors import RoverNcpError
from rover_ncp.course.course import Verdict
from sim.learn.agents import Plan, Snapshot, run_rounds
from sim.learn.cluster import DaskCluster
from sim.learn.evaluator import Evaluator
from sim.learn.record import Task, TrainSettings
from sim.learn.rollout import rollout
from sim.learn.run_folder import RunFolder, open_run
from sim.learn.workers import Inline, ProcessPool, available_processes, local_workers

# Checkpoints take at most this share of the time, so a short run saves often and a slow disk seldom.
_CHECKPOINT_SHARE = 0.02


class TrainResult(NamedTuple):
    """How a training run ended. Times in s of this call alone, which may have resumed an older run."""

    policy: Policy
    """The best agent's, as in ``policy_path``."""
    policy_path: Path
    verdict: Verdict
    """Of that policy on the course that it was trained on."""
    agents: Snapshot
    wall_s: float
    iterations_per_s: float | None
    """Iterations of all agents per second, without the start-up; None if none were done."""


def training_plan(settings: TrainSettings, task: Task) -> Plan:
    """Return what the agents of a run need to know."""
    return Plan(
        root_seed=settings.seed,
        strategy=settings.search,
        start=task.policy,
        build_evaluator=partial(Evaluator, task.policy, task.course, settings.rover),
    )


def train(
    settings: TrainSettings,
    out: Path,
    *,
    resume: bool = False,
    processes: int | None = None,
    cluster: str | None = None,
    on_progress: Callable[[Snapshot], None] = lambda snapshot: None,
    stop_when: Callable[[Snapshot, Policy], bool] = lambda snapshot, best: False,
) -> TrainResult:
    """Train ``settings.agents`` agents and leave the run in the folder ``out``.

    ``processes`` defaults to one for each core; ``cluster`` is the address of a Dask scheduler, whose workers
    then do the work. Both change the speed, never the result. After every round
    ``on_progress`` sees the agents, and ``stop_when``, which also gets the best one's policy, may end the
    training there. A run that is interrupted, however it dies, can be resumed and ends in the same files.

    Raises UsageError, ConfigError or FileError for settings or a folder that cannot be, WorkerDied if one
    of its processes was killed, KeyboardInterrupt.
    """
    began = time.monotonic()
    with open_run(out, settings, resume) as folder:
        plan = training_plan(settings, folder.task)
        rounds = _Rounds(folder, folder.load_agents(plan), on_progress, stop_when)
        count = min(processes or available_processes(), settings.agents)
        if rounds.snapshot.arrived(settings.iterations):
            count, cluster = 1, None
        try:
            with find_workers(count, cluster) as workers:
                run_rounds(workers, plan, rounds.snapshot, settings.iterations, rounds.after_round)
                policy = folder.policy(rounds.snapshot.best, rounds.snapshot)
        except (KeyboardInterrupt, RoverNcpError):
            if rounds.snapshot.arrived(0):
                folder.save_progress(rounds.snapshot)
            raise
        verdict = rollout(policy, folder.task.course, settings.rover).verdict
        folder.finish(rounds.snapshot)
        return TrainResult(
            policy=policy,
            policy_path=folder.policy_path,
            verdict=verdict,
            agents=rounds.snapshot,
            wall_s=time.monotonic() - began,
            iterations_per_s=rounds.iterations_per_s,
        )


def find_workers(count: int, cluster: str | None = None) -> Inline | ProcessPool | DaskCluster:
    """Return so many workers on this machine, or those of a cluster."""
    return local_workers(count) if cluster is None else DaskCluster(cluster)


class _Rounds:
    """Actions at the end of each round: display, checkpoint, stop condition."""

    def __init__(
        self,
        folder: RunFolder,
        start: Snapshot,
        on_progress: Callable[[Snapshot], None],
        stop_when: Callable[[Snapshot, Policy], bool],
    ) -> None:
        self.snapshot = start
        self.iterations_per_s: float | None = None
        self._folder = folder
        self._on_progress = on_progress
        self._stop_when = stop_when
        self._saved_s = self._save_cost_s = 0.0
        self._clock: tuple[float, int] | None = None

    def after_round(self, snapshot: Snapshot) -> bool:
        """Display, save, and return whether to stop."""
        now = time.monotonic()
        self.snapshot = snapshot
        if self._clock is None:
            # The first round holds the start of the processes and the compilation.
            self._clock = (now, snapshot.total_iterations)
        else:
            self.iterations_per_s = (snapshot.total_iterations - self._clock[1]) / (now - self._clock[0])
        self._on_progress(snapshot)
        if now - self._saved_s > self._save_cost_s / _CHECKPOINT_SHARE:
            self._folder.save_progress(snapshot)
            self._saved_s = time.monotonic()
            self._save_cost_s = self._saved_s - now
        return self._stop_when(snapshot, self._folder.policy(snapshot.best, snapshot))
