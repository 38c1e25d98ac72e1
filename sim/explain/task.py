"""Explanation of a circuit on a task that is no drive: a benchmark of the paper or a Gymnasium environment.

One episode is explained; the what-ifs are mean returns of the same few episodes.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from deploy.view.findings import Findings, analyse
from deploy.view.trace import Trace
from rover_ncp.circuit.policy import Policy
from rover_ncp.circuit.policy_file import load_policy
from rover_ncp.core.errors import UsageError
from rover_ncp.core.streams import Domain, episode_seeds
from sim.explain.explain import Explanation, command_line, explain_stored
from sim.explain.what_if import Sensitivity, damaged, part_title, sensitivities_of
from sim.learn.engine.environment import EnvironmentEvaluator, Play
from sim.learn.search.base import Seeds
from sim.paper.agents import build_agent
from sim.paper.play import BenchmarkEpisodes
from sim.paper.results import ResultStore
from sim.paper.score_file import benchmark_policy
from sim.paper.tasks import TASKS, Benchmark, Task

FloatArray = NDArray[np.float64]

EPISODES = 8


class Episodes(Protocol):
    """Episodes of a task with one policy."""

    enough: float | None

    def returns(self, vectors: FloatArray, seeds: Seeds) -> FloatArray:
        """Return the returns (n, k) of vectors (n, P), each in the episodes of seeds (k,)."""

    def play(self, seed: int) -> Play:
        """Play one episode of the policy."""

    def of(self, policy: Policy) -> Self:
        """Return those of another policy with the same inputs and outputs."""


@dataclass(frozen=True)
class TaskKnockout:
    """The episodes without a part."""

    kind: str
    """neuron or synapse."""
    name: str
    total: float
    """Mean return."""
    change: float
    """Difference to the intact circuit's."""

    @property
    def title(self) -> str:
        """The part's name for tables and charts."""
        return part_title(self.kind, self.name)


@dataclass(frozen=True, eq=False)
class TaskExplanation:
    """Result of ``rover-ncp explain --task``."""

    source: str
    command: str
    """That makes this."""
    policy: Policy
    task: str
    returns: FloatArray
    """(EPISODES,) of the intact circuit."""
    enough: float | None
    findings: Findings
    """Of the first episode."""
    knock_outs: tuple[TaskKnockout, ...]
    sensitivities: tuple[Sensitivity, ...]

    @property
    def title(self) -> str:
        """What was explained."""
        return f"Policy {self.policy.circuit.name} on {self.task}"

    @property
    def ending(self) -> str:
        """The score in words."""
        return f"mean return {self.returns.mean():.4g} of {len(self.returns)} episodes"

    def fields(self) -> dict[str, Any]:
        """Return everything but the potentials as plain values."""
        findings = self.findings
        return {
            "source": self.source,  #: the argument
            "policy": self.policy.circuit.name,  #: its name
            "task": self.task,
            "simulated": {  #: the intact circuit
                "return": float(self.returns.mean()),  #: their mean
                "returns": self.returns.tolist(),  #: of the episodes
                "enough": self.enough,  #: the return that counts as solved
            },
            **findings.fields((a, b) for b in findings.motors for a in findings.sources),
            "knock_outs": [vars(row) for row in self.knock_outs],
            "sensitivities": [{**vars(row), "slope": row.slope} for row in self.sensitivities],
        }


class Subject(NamedTuple):
    """What is explained, and its episodes."""

    source: str
    policy: Policy
    episodes: Episodes


RUNS = Path("results")
"""Folder of the runs of the paper's experiments."""


def explain_task(
    source: str | None,
    task: str,
    *,
    on_progress: Callable[[str], None] = lambda _: None,
    runs: Path = RUNS,
) -> Explanation | TaskExplanation:
    """Explain a policy (name or file) on a task; without one, the best stored circuit of the paper's.

    Raises UsageError, FileError and ConfigError.
    """
    command = command_line(source, task=task)
    known = TASKS.get(task)
    if known is not None and not isinstance(known, Benchmark):
        if source is not None:
            raise UsageError(f"--task {task}: explain a policy's drive without --task, with --course parking")
        name, parks = stored_policy(known, runs)
        return explain_stored(name, command, parks, on_progress=on_progress)
    subject = _subject(source, task, runs)
    policy, episodes = subject.policy, subject.episodes
    seeds = episode_seeds(0, Domain.EXPLAINED_EPISODES, EPISODES)
    [returns] = episodes.returns(policy.parameters()[None], seeds)
    play = episodes.play(int(seeds[0]))
    count = len(play.outputs)
    times = policy.tick_s * np.arange(count, dtype=np.float64)
    trace = Trace(policy, times, np.zeros((count + 1, 3)), play.outputs, play.potentials)
    parts = policy.circuit.size + policy.circuit.synapse_count
    on_progress(f"playing {EPISODES} episodes without each of {parts} neurons and synapses")
    without = []
    for kind, name, rest in damaged(policy):
        total = float(episodes.of(rest).returns(rest.parameters()[None], seeds).mean())
        without.append(TaskKnockout(kind, name, total, total - float(returns.mean())))
    on_progress(f"moving each of {policy.layout().size} parameters a little")
    return TaskExplanation(
        source=subject.source,
        command=command,
        policy=policy,
        task=task,
        returns=returns,
        enough=episodes.enough,
        findings=analyse(trace),
        knock_outs=tuple(without),
        sensitivities=sensitivities_of(policy, lambda rows: episodes.returns(rows, seeds).mean(axis=1)),
    )


def stored_policy(task: Task, runs: Path = RUNS) -> tuple[str, Policy]:
    """Return the best stored circuit of one of the paper's tasks, and its name. Raises UsageError."""
    results = ResultStore(runs).results(task.name, "circuit")
    if not results:
        raise UsageError(f"no circuit is stored for {task.name}: rover-ncp paper run --task {task.name}")
    best = max(results, key=lambda result: (result.success, result.mean))
    untrained = build_agent(task, "circuit", best.name.seed)
    assert isinstance(untrained, Policy)
    return f"paper run {best.name}", untrained.with_parameters(best.parameters.array())


def _subject(source: str | None, task: str, runs: Path) -> Subject:
    known = TASKS.get(task)
    if isinstance(known, Benchmark):
        if source is None:
            name, policy = stored_policy(known, runs)
        else:
            name, policy = source, benchmark_policy(source, known)
        return Subject(name, policy, BenchmarkEpisodes(known, policy))
    if source is None:
        raise UsageError(f"--task {task}: an environment needs a policy")
    policy = load_policy(source)
    return Subject(source, policy, EnvironmentEvaluator(task, policy))
