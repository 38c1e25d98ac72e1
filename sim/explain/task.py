"""Explanation of a circuit on a task that is no drive: a benchmark of the paper or a Gymnasium environment.

One episode is explained; the what-ifs are mean returns of the same few episodes.
"""

from pathlib import Path

import numpy as np

from rover_ncp.circuit.policy import Policy
from rover_ncp.circuit.policy_file import load_policy
from rover_ncp.core.errors import UsageError
from rover_ncp.core.streams import Domain, episode_seeds
from rover_ncp.course.course import load_course
from rover_ncp.neurons.trace import Trace
from sim.evaluate.benchmark import benchmark_policy
from sim.explain.explain import (
    Explanation,
    Progress,
    Simulated,
    command_line,
    explain_drive,
    explain_run,
)
from sim.explain.what_if import Outcome
from sim.learn.engine.environment import EnvironmentEvaluator
from sim.paper.evaluator import Evaluator
from sim.paper.interpretation import best_circuit, trained
from sim.paper.results import ResultStore
from sim.paper.tasks import TASKS, Benchmark, Task

EPISODES = 8


RUNS = Path("results")
"""Folder of the runs of the paper's experiments."""


def explain_task(
    source: str | None,
    task: str,
    *,
    on_progress: Progress = lambda _: None,
    runs: Path = RUNS,
) -> Explanation:
    """Explain a policy (name or file) on a task; without one, the best circuit of the published search.

    Raises UsageError, FileError and ConfigError.
    """
    command = command_line(source, task=task)
    known = TASKS.get(task)
    if known is not None and not isinstance(known, Benchmark):
        if source is not None:
            raise UsageError(f"--task {task}: explain a policy's drive without --task, with --course parking")
        name, parks = stored_policy(known, runs)
        return explain_drive(name, command, parks, load_course("parking"), on_progress=on_progress)
    name, policy, episodes = _subject(source, task, runs)
    seeds = episode_seeds(0, Domain.EXPLAINED_EPISODES, EPISODES)
    [returns] = episodes.returns(policy.parameters()[None], seeds)
    play = episodes.play(int(seeds[0]))
    count = len(play.outputs)
    times = policy.tick_s * np.arange(count, dtype=np.float64)

    def simulate(other: Policy) -> Outcome:
        return Outcome(float(episodes.of(other).returns(other.parameters()[None], seeds).mean()))

    return explain_run(
        Trace(policy, times, np.zeros((count + 1, 3)), play.outputs, play.potentials),
        Simulated(
            total=float(returns.mean()),
            returns=tuple(returns.tolist()),
            enough=episodes.enough,
            parked=None,
        ),
        simulate,
        lambda rows: episodes.returns(rows, seeds).mean(axis=1),
        on_progress,
        source=name,
        command=command,
        course=None,
        task=task,
        verdict=None,
    )


def stored_policy(task: Task, runs: Path = RUNS) -> tuple[str, Policy]:
    """Return the best stored circuit of one of the paper's tasks, and its name. Raises UsageError."""
    best = best_circuit(ResultStore(runs), task.name)
    if best is None:
        raise UsageError(
            f"{runs}: no circuit is stored for {task.name}; make one: "
            f"rover-ncp paper run --task {task.name} --agent circuit --seed 0"
        )
    return f"paper run {best.name}", trained(best)


def _subject(
    source: str | None, task: str, runs: Path
) -> tuple[str, Policy, Evaluator | EnvironmentEvaluator]:
    known = TASKS.get(task)
    if isinstance(known, Benchmark):
        if source is None:
            name, policy = stored_policy(known, runs)
        else:
            name, policy = source, benchmark_policy(source, known)
        return name, policy, Evaluator(known, policy)
    if source is None:
        raise UsageError(f"--task {task}: an environment needs a policy")
    policy = load_policy(source)
    return source, policy, EnvironmentEvaluator(task, policy)
