"""Training of an ensemble of agents on one course: what ``rover-ncp train`` does.

An agent is one search. Its path depends on the root seed and its number alone, neither on the agents beside
it nor on the number of processes. Agents are trained in blocks: those of a block share the lanes of one
evaluator, and a block is saved when it and all blocks before it have ended.
"""

import math
import time
from collections.abc import Callable, Generator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from pathlib import Path
from statistics import median
from typing import Any, NamedTuple

import numpy as np
from pydantic import BaseModel, Field

from rover_ncp.circuit.compiled import dead_parameters
from rover_ncp.circuit.policy import Policy
from rover_ncp.core.config import validated
from rover_ncp.core.streams import Domain, random_stream
from rover_ncp.course.scoring import Failure, Verdict
from sim.learn.curve import Agent, curve_csv, curve_png
from sim.learn.evaluator import Evaluator
from sim.learn.folder import RunFolder, open_run
from sim.learn.rollout import rollout
from sim.learn.search import Batch, Scores, start_search
from sim.learn.settings import Task, TrainSettings, load_task
from sim.learn.workers import available_processes, cluster_workers, local_workers, made_in_each_process

BLOCK = 6
"""Agents of a block at most: fewer leave lanes idle, more lose more work when a run dies."""
_CLUSTER_BLOCK = 2
"""The same on a cluster, whose workers come and go."""


@dataclass(frozen=True)
class Ensemble:
    """The agents that have ended, by number."""

    agents: tuple[Agent, ...]
    accepted: Agent | None = None
    """The one that ended the training."""

    @property
    def returns(self) -> list[float]:
        """Each agent's return."""
        return [agent.value for agent in self.agents]

    @property
    def best(self) -> Agent:
        """The agent that ended the training, otherwise that of the highest return, the first of equals."""
        return self.accepted or max(self.agents, key=lambda agent: agent.value)

    @property
    def median_return(self) -> float:
        """The median of the agents' returns."""
        return float(median(self.returns))

    def __str__(self) -> str:
        return f"best {self.best.value:.4f}  median {self.median_return:.4f}"


class TrainResult(BaseModel):
    """Result of the command; the verdict is the best agent's."""

    parked: bool = Field(description="whether the rover parked")
    error_m: float = Field(description="final position error")
    error_rad: float = Field(description="final heading error")
    reason: str = Field(description="why it did not park, or empty")
    failure: Failure = Field(description="the first condition that was missed, or empty")
    returns: list[float] = Field(description="by agent")
    best_return: float = Field(description="of all agents")
    median_return: float = Field(description="of all agents")
    wall_s: float = Field(description="how long it took")
    seed: int = Field(description="root seed")
    agents: int = Field(description="how many")
    iterations: int = Field(description="of each agent")
    out: str = Field(description="the folder")
    policy: str = Field(description="the best agent's file")


class Trained(NamedTuple):
    """How a training run ended."""

    policy: Policy
    """The best agent's, as in ``policy_path``."""
    policy_path: Path
    verdict: Verdict
    """Of that policy on the course that it was trained on."""
    agents: Ensemble
    wall_s: float
    """Time of this call alone, which may have resumed an older run."""


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
) -> Trained:
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
    task = load_task(settings)
    with open_run(Path(out), settings, task, resume) as folder:
        run = _Run(folder, settings, task)
        missing = run.missing
        count = min(processes or available_processes(), max(len(missing), 1))
        blocks = _blocks(missing, count, block) if cluster is None else _blocks(missing, 1, _CLUSTER_BLOCK)
        make = partial(_block_trainer, settings, task)
        with cluster_workers(cluster) if cluster is not None and blocks else local_workers(count) as workers:
            for agents in workers(made_in_each_process(make), blocks):
                run.take(agents, accept)
                on_progress(run.ensemble)
                if run.ensemble.accepted:
                    break
        run.finish()
        best = run.policy(run.ensemble.best)
        return Trained(
            policy=best,
            policy_path=folder.policy_path,
            verdict=rollout(best, task.course, task.rover).verdict,
            agents=run.ensemble,
            wall_s=time.monotonic() - began,
        )


def _blocks(numbers: Sequence[int], processes: int, most: int) -> list[Sequence[int]]:
    """Return agents in blocks of nearly one size, as many for each process."""
    count = processes * -(-len(numbers) // (processes * most))
    bounds = [len(numbers) * place // max(count, 1) for place in range(count + 1)]
    return [numbers[a:b] for a, b in pairwise(bounds) if a < b]


def _block_trainer(settings: TrainSettings, task: Task) -> Callable[[Sequence[int]], list[Agent]]:
    return partial(train_block, settings, task.policy, Evaluator(task.policy, task.course, task.rover))


def train_block(
    settings: TrainSettings, start: Policy, evaluator: Evaluator, numbers: Sequence[int]
) -> list[Agent]:
    """Train agents side by side: their pending batches share one queue, which keeps its lanes busy."""
    running = [_run_agent(settings, start, number) for number in numbers]
    stream, ended = evaluator.stream(len(running)), {}
    for place, agent in enumerate(running):
        stream.submit(place, next(agent))
    while answers := stream.collect():
        for place, scores in answers:
            try:
                stream.submit(place, running[place].send(scores))
            except StopIteration as end:
                ended[place] = end.value
    return [ended[place] for place in range(len(numbers))]


def _run_agent(settings: TrainSettings, start: Policy, number: int) -> Generator[Batch, Scores, Agent]:
    """Search from a policy's parameters; return the agent after as many candidates as it has iterations."""
    search = start_search(
        settings.search,
        start.layout(),
        start.parameters(),
        random_stream(settings.seed, Domain.AGENT, number),
        dead_parameters(start),
    )
    batch, vector, best = next(search), start.parameters(), -math.inf
    improvements: list[tuple[int, float]] = []
    done, end = 0, settings.iterations + 1  # the start is no iteration
    while True:
        if len(batch.vectors) > end - done:
            batch = Batch(batch.vectors[: end - done], batch.to_beat[: end - done])
        scores = yield batch
        for place, value in enumerate(scores.returns.tolist()):
            if value > best:
                vector, best = batch.vectors[place].copy(), value
                improvements.append((done + place, value))
        done += len(batch.vectors)
        if done == end:
            return Agent(number=number, vector=vector.tolist(), improvements=tuple(improvements))
        batch = search.send(scores)


class _Run:
    """The agents of a run that have ended, and their files."""

    def __init__(self, folder: RunFolder, settings: TrainSettings, task: Task) -> None:
        self._folder, self._settings, self._task = folder, settings, task
        saved = (folder.read(_file_of(number), Agent) for number in range(settings.agents))
        self.ensemble = Ensemble(tuple(agent for agent in saved if agent))

    @property
    def missing(self) -> list[int]:
        """The agents to train."""
        ended = {agent.number for agent in self.ensemble.agents}
        return [number for number in range(self._settings.agents) if number not in ended]

    def take(self, agents: Sequence[Agent], accept: Callable[[Policy], bool]) -> None:
        """Save the agents of a block, up to the first one that is accepted."""
        try:
            for agent in agents:
                self._folder.write(_file_of(agent.number), agent)
                ended = sorted([*self.ensemble.agents, agent], key=lambda each: each.number)
                self.ensemble = Ensemble(tuple(ended), agent if accept(self.policy(agent)) else None)
                if self.ensemble.accepted:
                    break
        finally:  # also when a Ctrl-C comes in between
            self._write_best()

    def _write_best(self) -> None:
        """Write the best policy and the table of the curves."""
        if self.ensemble.agents:
            self._folder.write("policy.yaml", self.policy(self.ensemble.best))
            self._folder.write("curve.csv", curve_csv(self.ensemble.agents, self._settings.iterations))

    def finish(self) -> None:
        """Write each agent's policy and the picture."""
        self._write_best()
        agents, settings = self.ensemble.agents, self._settings
        for agent in agents:
            self._folder.write(f"agents/{agent.number:02}.yaml", self.policy(agent))
        title = f"{self._task.course.name}, {settings.search} search, seed {settings.seed}"
        self._folder.write("curve.png", curve_png(agents, settings.iterations, title))

    def policy(self, agent: Agent) -> Policy:
        """Return an agent's best parameters as a policy with its provenance."""
        provenance = self._folder.record.provenance(
            self._settings.iterations, **{"agent": agent.number, "return": agent.value}
        )
        policy = self._task.policy.with_parameters(np.array(agent.vector))
        return replace(policy, provenance=provenance)


def _file_of(number: int) -> str:
    return f"agents/{number:02}.json"
