"""Training of an ensemble of agents on one course: what ``rover-ncp train`` does.

An agent is one search. Its path depends on the root seed and its number alone, neither on the agents beside
it nor on the number of processes. Agents are trained in blocks: those of a block share the lanes of one
evaluator, and a block is saved when it and all blocks before it have ended.
"""

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import pairwise
from pathlib import Path
from statistics import median
from typing import Any, NamedTuple

import numpy as np

from rover_ncp.circuit.compiled import dead_parameters
from rover_ncp.circuit.policy import Policy
from rover_ncp.core.config import validated
from rover_ncp.core.streams import Domain, random_stream
from rover_ncp.course.scoring import Verdict
from sim.learn.curve import Agent, curve_csv, curve_png, note_improvement
from sim.learn.evaluator import Evaluator
from sim.learn.folder import RunFolder, open_run
from sim.learn.rollout import rollout
from sim.learn.search.strategies import Batch, Scores, start_search
from sim.learn.settings import Record, Task, TrainSettings, resolve_task
from sim.learn.workers import available_processes, cluster_workers, local_workers, made_in_each_process

BLOCK = 6
"""Agents of a block at most: fewer leave lanes idle, more lose more work when a run dies."""
_CLUSTER_BLOCK = 2
"""The same on a cluster, whose workers come and go."""


@dataclass(frozen=True)
class Plan:
    """Data that every process needs; it is passed between processes by pickle."""

    root_seed: int
    search: str
    iterations: int
    """Candidates of each agent after its start."""
    start: Policy
    """Its parameters are the defaults of the search."""
    build_evaluator: Callable[[], Evaluator]


@dataclass(frozen=True)
class Ensemble:
    """The agents that have ended, by number."""

    agents: tuple[Agent, ...]
    accepted: bool = False
    """Whether the last one ended the training."""

    @property
    def returns(self) -> list[float]:
        """Each agent's return."""
        return [agent.value for agent in self.agents]

    @property
    def best(self) -> Agent:
        """The agent that ended the training, otherwise that of the highest return, the first of equals."""
        return self.agents[-1] if self.accepted else max(self.agents, key=lambda agent: agent.value)

    @property
    def median_return(self) -> float:
        """The median of the agents' returns."""
        return float(median(self.returns))

    def __str__(self) -> str:
        return f"best {self.best.value:.4f}  median {self.median_return:.4f}"


@dataclass
class _Path:
    """An agent on its way through its iterations."""

    plan: Plan
    number: int
    vector: list[float] = field(default_factory=list)
    value: float = -math.inf
    improvements: list[tuple[int, float]] = field(default_factory=list)
    done: int = 0
    """Candidates scored, with the start."""

    def __post_init__(self) -> None:
        start, rng = self.plan.start, random_stream(self.plan.root_seed, Domain.AGENT, self.number)
        self._search = start_search(
            self.plan.search, start.layout(), start.parameters(), rng, dead_parameters(start)
        )
        self.batch = self._within_limit(next(self._search))

    def _within_limit(self, batch: Batch) -> Batch:
        left = self.plan.iterations + 1 - self.done
        return Batch(batch.vectors[:left], batch.to_beat[:left])

    def take(self, scores: Scores) -> bool:
        """Take the scores of the batch and propose the next one; return whether there is one."""
        for vector, value in zip(self.batch.vectors, scores.returns.tolist(), strict=True):
            if value > self.value:
                self.vector, self.value = vector.tolist(), value
                note_improvement(self.improvements, self.done, value)
            self.done += 1
        if self.done > self.plan.iterations:
            return False
        self.batch = self._within_limit(self._search.send(scores))
        return True


def train_block(plan: Plan, evaluator: Evaluator, numbers: Sequence[int]) -> list[Agent]:
    """Train agents side by side: their pending batches share one queue, which keeps its lanes busy."""
    paths = [_Path(plan, number) for number in numbers]
    stream = evaluator.stream(len(paths))
    for place, path in enumerate(paths):
        stream.submit(place, path.batch)
    while answers := stream.collect():
        for place, scores in answers:
            if paths[place].take(scores):
                stream.submit(place, paths[place].batch)
    return [Agent(path.number, path.vector, path.improvements) for path in paths]


def _block_trainer(plan: Plan) -> Callable[[Sequence[int]], list[Agent]]:
    return partial(train_block, plan, plan.build_evaluator())


class TrainResult(NamedTuple):
    """How a training run ended. Times in s of this call alone, which may have resumed an older run."""

    policy: Policy
    """The best agent's, as in ``policy_path``."""
    policy_path: Path
    verdict: Verdict
    """Of that policy on the course that it was trained on."""
    agents: Ensemble
    wall_s: float
    iterations_per_s: float | None
    """Iterations of all agents per second; None if none were done."""


def training_plan(settings: TrainSettings, task: Task) -> Plan:
    """Return what the agents of a run need to know."""
    return Plan(
        root_seed=settings.seed,
        search=settings.search,
        iterations=settings.iterations,
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
    on_progress: Callable[[Ensemble], None] = lambda ensemble: None,
    accept: Callable[[Policy], bool] = lambda policy: False,
    block: int = BLOCK,
) -> TrainResult:
    """Train ``settings.agents`` agents and leave the run in the folder ``out``.

    ``settings`` are `sim.learn.settings.TrainSettings` or a mapping with some of their fields: course,
    circuit, seed, agents, iterations, search.
    ``processes`` defaults to one for each core; ``cluster`` is the address of a Dask scheduler, whose workers
    then do the work. Both change the speed, never the result. After every block ``on_progress`` gets the
    agents so far. ``accept`` gets each agent's policy, in order; the first one that it accepts ends the
    training and is the result. Up to ``block`` agents are trained side by side and saved together. A run that
    is interrupted, however it dies, can be resumed and ends in the same files.

    Raises UsageError, ConfigError or FileError for settings or a folder that cannot be, WorkerDied if one
    of its processes was killed, KeyboardInterrupt.
    """
    began = time.monotonic()
    settings = validated(settings, TrainSettings, "train")
    task = resolve_task(settings)
    plan = training_plan(settings, task)
    with open_run(Path(out), Record[TrainSettings].of(settings, task.policy, task.course), resume) as folder:
        run = _Run(folder, task)
        missing = run.missing
        count = min(processes or available_processes(), max(len(missing), 1))
        blocks = _blocks(missing, count, block) if cluster is None else _blocks(missing, 1, _CLUSTER_BLOCK)
        with cluster_workers(cluster) if cluster is not None and blocks else local_workers(count) as workers:
            trained = workers.map(made_in_each_process(partial(_block_trainer, plan)), blocks)
            for agents in trained:
                run.take(agents, accept)
                on_progress(run.ensemble)
                if run.ensemble.accepted:
                    break
        wall_s = time.monotonic() - began
        run.finish()
        return TrainResult(
            policy=run.policy(run.ensemble.best),
            policy_path=folder.policy_path,
            verdict=rollout(run.policy(run.ensemble.best), task.course, settings.rover).verdict,
            agents=run.ensemble,
            wall_s=wall_s,
            iterations_per_s=run.trained * settings.iterations / wall_s if run.trained else None,
        )


def _blocks(numbers: Sequence[int], processes: int, most: int) -> list[Sequence[int]]:
    """Return agents in blocks of nearly one size, as many for each process."""
    count = processes * -(-len(numbers) // (processes * most))
    bounds = [len(numbers) * place // max(count, 1) for place in range(count + 1)]
    return [numbers[a:b] for a, b in pairwise(bounds) if a < b]


class _Run:
    """The agents of a run that have ended, and their files."""

    def __init__(self, folder: RunFolder[TrainSettings], task: Task) -> None:
        self._folder, self._task = folder, task
        self._agents: dict[int, Agent] = {}
        self._accepted = False
        self.trained = 0
        """Agents of this call."""
        for number in range(folder.record.settings.agents):
            if state := folder.read_state(_file_of(number)):
                changes = tuple((iteration, value) for iteration, value in state["improvements"])
                self._agents[number] = Agent(number, state["vector"], changes)

    @property
    def ensemble(self) -> Ensemble:
        """The agents so far."""
        return Ensemble(tuple(self._agents[number] for number in sorted(self._agents)), self._accepted)

    @property
    def missing(self) -> list[int]:
        """The agents to train."""
        agents = range(self._folder.record.settings.agents)
        return [number for number in agents if number not in self._agents]

    def take(self, agents: Sequence[Agent], accept: Callable[[Policy], bool]) -> None:
        """Save the agents of a block, up to the first one that is accepted."""
        try:
            for agent in agents:
                state = {"vector": agent.vector, "improvements": agent.improvements}
                self._folder.write_state(_file_of(agent.number), state)
                self._agents[agent.number] = agent
                self.trained += 1
                if accept(self.policy(agent)):
                    self._accepted = True
                    break
        finally:  # also when a Ctrl-C comes in between
            if self._agents:
                self._write_best()

    def _write_best(self) -> None:
        """Write the best policy and the table of the curves."""
        self._folder.write("policy.yaml", self.policy(self.ensemble.best))
        table = curve_csv(self.ensemble.agents, self._folder.record.settings.iterations)
        self._folder.write("curve.csv", table)

    def finish(self) -> None:
        """Write each agent's policy and the picture."""
        self._write_best()
        agents, settings = self.ensemble.agents, self._folder.record.settings
        for agent in agents:
            self._folder.write(f"agents/{agent.number:02}.yaml", self.policy(agent))
        title = f"{self._task.course.name}, {settings.search} search, seed {settings.seed}"
        self._folder.write("curve.png", curve_png(agents, settings.iterations, title))

    def policy(self, agent: Agent) -> Policy:
        """Return an agent's best parameters as a policy with its provenance."""
        settings = self._folder.record.settings
        provenance = self._folder.record.provenance(
            settings.iterations, **{"agent": agent.number, "return": agent.value}
        )
        policy = self._task.policy.with_parameters(np.array(agent.vector))
        return replace(policy, provenance=provenance)


def _file_of(number: int) -> str:
    return f"agents/{number:02}.json"
