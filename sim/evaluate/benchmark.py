"""Score of a circuit file on one of the paper's benchmarks: ``rover-ncp eval FILE --task NAME``."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from rover_ncp.circuit.policy import Policy
from rover_ncp.circuit.policy_file import load_start
from rover_ncp.core.errors import ConfigError, UsageError
from sim.evaluate.results import BenchmarkResult
from sim.learn.search.base import draw_seeds
from sim.paper.evaluator import Evaluator
from sim.paper.tasks import Benchmark, find_task

EPISODES = 100


def score_circuit(
    file: str, task_name: str, ranges: Sequence[str] = (), episodes: int = EPISODES, seed: int = 0
) -> BenchmarkResult:
    """Return the score of a circuit in episodes of a task, with other sensor ranges if such are given.

    Raises as `benchmark_policy`.
    """
    task = find_task(task_name)
    if not isinstance(task, Benchmark):
        raise UsageError(f"{task_name}: use eval without --task, with --course parking")
    policy = _with_ranges(benchmark_policy(file, task), ranges)
    vectors = np.tile(policy.parameters(), (episodes, 1))
    found = Evaluator(task, policy).run(vectors, draw_seeds(seed, (0,), episodes))
    returns, plain = found[:, :2].sum(axis=1), found[:, 0]
    return BenchmarkResult(
        task=task_name,
        episodes=episodes,
        return_=float(returns.mean()),
        std=float(returns.std()),
        plain_return=float(plain.mean()),
        successes=int((plain >= task.success).sum()),
        success=bool(plain.mean() >= task.success),
        ranges={channel.name: max(end for _, end in channel.sides) for channel in policy.sensing.channels},
    )


def benchmark_policy(file: str, task: Benchmark) -> Policy:
    """Load a circuit, which gets the task's sensing and motors, or a policy, which has its own.

    A ``.bnn`` circuit gets unclamped sensors, as it was trained with. Raises UsageError, FileError, or
    ConfigError when a circuit lacks a neuron that the task's mapping names, or for a policy of another task.
    """
    start = load_start(file)
    if isinstance(start, Policy):
        own = task.policy(task.circuit())
        for what, found, expected in (
            ("inputs", start.sensing.inputs, own.sensing.inputs),
            ("outputs", start.motors.outputs, own.motors.outputs),
        ):
            if found != expected:
                problem = f"its {what} are {', '.join(found)}; {task.name} has {', '.join(expected)}"
                raise ConfigError(f"policy {start.circuit.name}", [problem])
        return start
    policy = task.policy(start)
    if policy.input_layer is not None:
        raise UsageError(f"{task.name} has linear layers, which a circuit file does not contain")
    if file.endswith(".bnn"):
        policy = replace(policy, sensing=policy.sensing.model_copy(update={"clamp": False}))
    return policy


def _with_ranges(policy: Policy, ranges: Sequence[str]) -> Policy:
    """Return a policy with other sensor ranges, each as ``NAME=LIMIT``. Raises UsageError."""
    channels = {channel.name: channel for channel in policy.sensing.channels}
    for text in ranges:
        name, _, number = text.partition("=")
        if name not in channels:
            raise UsageError(f"--range {text}: expected NAME=LIMIT; the task senses {', '.join(channels)}")
        try:
            limit = float(number)
        except ValueError:
            limit = math.nan
        if not 0.0 < limit < math.inf:
            raise UsageError(f"--range {text}: expected NAME=LIMIT with a number above 0")
        channels[name] = channels[name].model_copy(update={"maximum": limit, "minimum": -limit})
    sensing = policy.sensing.model_copy(update={"channels": tuple(channels.values())})
    return replace(policy, sensing=sensing)
