"""Training of an ensemble of agents on one course: what ``rover-ncp train`` does."""

import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from rover_ncp.circuit.policy import Policy
from rover_ncp.core.config import validated
from rover_ncp.course.scoring import Verdict
from sim.learn.agents import AgentState, Plan, Snapshot, run_rounds
from sim.learn.cluster import DaskCluster
from sim.learn.curve import curve_csv, curve_png
from sim.learn.engine.evaluator import Evaluator
from sim.learn.engine.rollout import rollout
from sim.learn.record import Record, Task, TrainSettings, resolve_task
from sim.learn.run_folder import RunFolder, checkpoints, open_run
from sim.learn.workers import available_processes, local_workers


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
    settings: TrainSettings | Mapping[str, Any],
    out: str | Path,
    *,
    resume: bool = False,
    processes: int | None = None,
    cluster: str | None = None,
    on_progress: Callable[[Snapshot], None] = lambda snapshot: None,
    stop_when: Callable[[Snapshot, Policy], bool] = lambda snapshot, best: False,
) -> TrainResult:
    """Train ``settings.agents`` agents and leave the run in the folder ``out``.

    ``settings`` are `sim.learn.record.TrainSettings` or a mapping with some of their fields: course, circuit,
    seed, agents, iterations, search.
    ``processes`` defaults to one for each core; ``cluster`` is the address of a Dask scheduler, whose workers
    then do the work. Both change the speed, never the result. After every round ``on_progress`` gets the
    agents, and ``stop_when``, which also gets the best one's policy, may end the training there. A run that
    is interrupted, however it dies, can be resumed and ends in the same files.

    Raises UsageError, ConfigError or FileError for settings or a folder that cannot be, WorkerDied if one
    of its processes was killed, KeyboardInterrupt.
    """
    began = time.monotonic()
    settings = validated(settings, TrainSettings, "train")
    task = resolve_task(settings)
    plan = training_plan(settings, task)
    with open_run(Path(out), Record[TrainSettings].of(settings, task.policy, task.course), resume) as folder:
        run = _Ensemble(folder, task)
        count = min(processes or available_processes(), settings.agents)
        if run.snapshot.arrived(settings.iterations):
            count, cluster = 1, None
        workers = local_workers(count) if cluster is None else DaskCluster(cluster)
        with checkpoints(run.save) as checkpoint, workers:

            def after_round(snapshot: Snapshot) -> bool:
                run.take(snapshot)
                on_progress(snapshot)
                checkpoint()
                return stop_when(snapshot, run.policy(snapshot.best))

            run_rounds(workers, plan, run.snapshot, settings.iterations, after_round)
        policy = run.policy(run.snapshot.best)
        verdict = rollout(policy, task.course, settings.rover).verdict
        run.finish()
        return TrainResult(
            policy=policy,
            policy_path=folder.policy_path,
            verdict=verdict,
            agents=run.snapshot,
            wall_s=time.monotonic() - began,
            iterations_per_s=run.iterations_per_s,
        )


class _Ensemble:
    """The agents of a run, which begin where their files say, and these files."""

    def __init__(self, folder: RunFolder[TrainSettings], task: Task) -> None:
        self._folder, self._task = folder, task
        agents = range(folder.record.settings.agents)
        self.snapshot = Snapshot(tuple(self._load(number) for number in agents))
        self.iterations_per_s: float | None = None
        self._clock: tuple[float, int] | None = None

    def _load(self, number: int) -> AgentState:
        """Read an agent; one without a file has not begun. Raises FileError for a damaged or foreign file."""
        state = self._folder.read_state(_file_of(number))
        if state is None:
            return AgentState(number)
        improvements = tuple((iteration, value) for iteration, value in state["improvements"])
        return AgentState(number, state["search"], improvements)

    def take(self, snapshot: Snapshot) -> None:
        """Take the agents at the end of a round."""
        self.snapshot = snapshot
        if self._clock is None:
            # The first round holds the start of the processes and the compilation.
            self._clock = time.monotonic(), snapshot.total_iterations
        else:
            began, iterations = self._clock
            self.iterations_per_s = (snapshot.total_iterations - iterations) / (time.monotonic() - began)

    def save(self) -> None:
        """Write the agents, the best policy and the table of the curves, if all have begun."""
        now, write = self.snapshot, self._folder.write
        if not now.arrived(0):
            return
        for agent in now.agents:
            state = {"improvements": agent.improvements, "search": agent.search}
            self._folder.write_state(_file_of(agent.number), state)
        write("policy.yaml", self.policy(now.best))
        write("curve.csv", curve_csv(now.agents, now.iterations))

    def finish(self) -> None:
        """Write everything, with each agent's policy and the picture."""
        self.save()
        now, settings = self.snapshot, self._folder.record.settings
        for agent in now.agents:
            self._folder.write(f"agents/{agent.number:02}.yaml", self.policy(agent))
        title = f"{self._task.course.name}, {settings.search} search, seed {settings.seed}"
        self._folder.write("curve.png", curve_png(now.agents, now.iterations, title))

    def policy(self, agent: AgentState) -> Policy:
        """Return an agent's incumbent as a policy with its provenance."""
        if agent.search is None:
            raise ValueError(f"agent {agent.number} has not begun")
        provenance = self._folder.record.provenance(
            self.snapshot.iterations, **{"agent": agent.number, "return": agent.value}
        )
        policy = self._task.policy.with_parameters(np.array(agent.search["incumbent"]))
        return replace(policy, provenance=provenance)


def _file_of(number: int) -> str:
    return f"agents/{number:02}.json"
