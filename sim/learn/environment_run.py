"""Training on a Gymnasium environment: what ``rover-ncp train --task`` does.

A cost is minus a return. Each
generation plays other episodes, the same for all its candidates.
"""

from collections.abc import Callable
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rover_ncp.circuit.policy import Policy
from rover_ncp.circuit.policy_file import load_start
from rover_ncp.core.errors import UsageError
from rover_ncp.core.streams import Domain, episode_seeds
from sim.learn.engine.environment import Environment, EnvironmentEvaluator, make_environment, require_fit
from sim.learn.record import Record, TaskSettings
from sim.learn.robust import Drive, Generation, RobustSearch, Schedule, Stage, policy_box
from sim.learn.robust_run import RobustResult, SearchRun
from sim.learn.run_folder import open_run

FloatArray = NDArray[np.float64]

EPISODES = 100
"""Fresh episodes that score a policy."""
_SCHEDULE = Schedule((Stage(0, 1, 0.005, 0.0, 0.0, 0.0, False),), 0.15, 0.3)
"""A circuit of one's own begins far from any solution."""


class Score(NamedTuple):
    """Returns in fresh episodes."""

    episodes: int
    mean: float
    std: float
    successes: int | None
    """Episodes that reach the environment's threshold; None where it names none."""

    def __str__(self) -> str:
        solved = "" if self.successes is None else f", {self.successes} of them successful"
        return f"return {self.mean:.4g} ± {self.std:.3g} in {self.episodes} fresh episodes{solved}"


def _episodes(task: str, start: Policy, seed: int) -> Drive:
    evaluator = EnvironmentEvaluator(task, start)

    def drive(vectors: FloatArray, first: int, count: int, stage: Stage) -> FloatArray:
        return -evaluator.returns(vectors, episode_seeds(seed, Domain.TRAINING_EPISODES, count, first))

    return drive


def start_of(settings: TaskSettings) -> Policy:
    """Return the untuned policy. Raises UsageError, FileError, or ConfigError if it does not fit the task."""
    start = load_start(settings.circuit)
    if not isinstance(start, Policy):
        problem = "is a circuit alone; a task needs a policy file, which also has sensing and motors"
        raise UsageError(f"{settings.circuit}: {problem}")
    with closing(make_environment(settings.task)) as environment:
        require_fit(settings.task, environment, start)
    return start


def train_task(
    settings: TaskSettings,
    out: Path,
    *,
    resume: bool = False,
    processes: int | None = None,
    on_generation: Callable[[Generation], None] = lambda _: None,
) -> RobustResult:
    """Train a policy on an environment and leave the run in the folder ``out``.

    Behaves as `train_robust`, and raises the same errors.
    """
    start = start_of(settings)
    record = Record[TaskSettings].of(settings, start, None)
    search = RobustSearch(
        policy_box(start),
        seed=settings.seed,
        rollouts=settings.rollouts,
        worst=settings.rollouts,
        schedule=_SCHEDULE,
    )
    with open_run(out, record, resume) as folder:
        run = SearchRun(folder, start, search)
        return run.finish(partial(_episodes, settings.task, start, settings.seed), processes, on_generation)


def score_task(
    task: str, policy: Policy, episodes: int = EPISODES, seed: int = 0, made: Environment | None = None
) -> Score:
    """Return the score of a policy in fresh episodes. Raises as `EnvironmentEvaluator`."""
    evaluator = EnvironmentEvaluator(task, policy, made)
    [returns] = evaluator.returns(policy.parameters(), episode_seeds(seed, Domain.SCORING_EPISODES, episodes))
    successes = None if evaluator.enough is None else int((returns >= evaluator.enough).sum())
    return Score(episodes, float(returns.mean()), float(returns.std()), successes)
