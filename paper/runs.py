"""The grid of runs, their results as stored, the training of a run, and its replay.

A results folder has one JSON-lines file for each budget and task, ``BUDGET/TASK.jsonl``, with a line
for each run.
"""

import json
import math
import multiprocessing
import os
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import replace
from enum import StrEnum
from functools import cache
from importlib import metadata
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple, Self

import numpy as np
from pydantic import ConfigDict, ValidationError, model_validator

from paper.episodes import PlantEvaluator, library
from paper.gradients import score_actor, train_actor
from paper.search import Budget, ParkingEvaluator, run_search
from paper.tasks import (
    AGENTS,
    GRADIENTS,
    NETWORKS,
    PAPERS,
    TASKS,
    Benchmark,
    Net,
    Task,
    Vector,
    build_agent,
    draw_seeds,
)
from rover_ncp.circuit.policy import Policy
from rover_ncp.core.config import StrictModel
from rover_ncp.core.errors import FileError, UsageError
from rover_ncp.core.files import read_text
from rover_ncp.core.spawned import end_with_parent
from sim.learn.settings import made_with

_FINAL = 99
"""Stream of the fresh episodes that a run is judged by."""
_EPISODES = 100
_NETWORK_SETTINGS = (10, 5, "published-network", 20_000)
"""Rollouts, worst rollouts and iterations of the published search of MLP and LSTM."""
_QUICK_ITERATIONS = 30
_source = cache(made_with)  # a process loads its code once
TOLERANCE = 1e-9
"""Difference in a return that another machine may make. A half-cheetah's contacts amplify a last bit, so its
replay is compared by its verdict."""
_SEEDS = 10
_PARKING_SEEDS = 48
"""As many as were measured with the published code itself."""


class BudgetName(StrEnum):
    """Budget of a run, and the search that spends it."""

    PUBLISHED = "published"
    """The paper's iterations and rollouts with the search of its published code."""
    ALGORITHM1 = "algorithm1"
    """The paper's iterations and rollouts with Algorithm 1 as it is printed."""
    GRADIENTS = "gradients"
    """Training by PPO or A2C, for which the paper gives no settings."""
    QUICK = "quick"
    """A few iterations of the published search."""


_OTHERS: dict[BudgetName, tuple[tuple[str, ...], Sequence[str]]] = {
    BudgetName.GRADIENTS: (("pendulum", "mountain-car"), GRADIENTS),  # the paper's Table III
    BudgetName.ALGORITHM1: (("parking", "pendulum", "mountain-car", "cart-pole"), PAPERS[:1]),
}
"""Tasks and agents of the budgets that not all tasks have."""


class RunName(StrictModel):
    """Coordinates of a run in the grid."""

    task: str
    agent: str
    seed: int
    budget: BudgetName = BudgetName.PUBLISHED

    def __str__(self) -> str:
        return f"{self.budget} {self.task} {self.agent} {self.seed}"


class Packed(StrictModel):
    """An array of float64 as its shape and its little-endian bytes in hexadecimal digits."""

    shape: tuple[int, ...]
    float64: str

    @model_validator(mode="after")
    def _can_be_unpacked(self) -> Self:
        self.array()
        return self

    @classmethod
    def of(cls, array: Vector) -> "Packed":
        """Pack an array."""
        return cls(shape=array.shape, float64=array.astype("<f8").tobytes().hex())

    def array(self) -> Vector:
        """Return the array."""
        return np.frombuffer(bytes.fromhex(self.float64), "<f8").astype(np.float64).reshape(self.shape)


class Score(StrictModel):
    """Returns of trained parameters in fresh episodes."""

    episodes: int
    mean: float
    std: float
    plain_mean: float
    success: bool


class Result(Score):
    """A finished run: its score and cost, and the trained parameters."""

    model_config = ConfigDict(extra="ignore")
    """Lines of other versions may say more."""

    name: RunName
    settings: dict[str, Any]
    made_with: dict[str, str]
    wall_s: float
    cpu_s: float
    evaluations: int
    steps: int
    """Of the environment, in all episodes."""
    curve: tuple[tuple[int, int, float], ...]
    """Changes of the incumbent's estimate: (iterations, environment steps, estimate); of PPO and A2C none."""
    parameters: Packed
    """The trained vector (P,)."""

    @property
    def score(self) -> Score:
        """The score alone."""
        return Score(**self.model_dump(include=set(Score.model_fields)))

    def value_after(self, iterations: int) -> float:
        """Return the incumbent's estimate after so many iterations of a search."""
        return [value for count, _, value in self.curve if count <= iterations][-1]


class ResultStore:
    """The results in a folder, ``BUDGET/TASK.jsonl``. Of two runs of one name the last one counts."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._read: dict[Path, dict[tuple[str, int], Result]] = {}

    def path(self, task: str, budget: str) -> Path:
        """Return the file of a task and a budget."""
        return self.folder / budget / f"{task}.jsonl"

    def find(self, name: RunName) -> Result | None:
        """Return a run. Raises FileError."""
        return self._runs(self.path(name.task, name.budget)).get((name.agent, name.seed))

    def results(self, task: str, agent: str, budget: str = BudgetName.PUBLISHED) -> list[Result]:
        """Return the finished runs of an agent, by seed. Raises FileError."""
        runs = self._runs(self.path(task, budget)).values()
        return sorted((run for run in runs if run.name.agent == agent), key=lambda run: run.name.seed)

    def returns(self, task: str, agent: str, budget: str = BudgetName.PUBLISHED) -> Vector:
        """Return the mean returns (n,) of these runs. Raises FileError."""
        return np.array([run.mean for run in self.results(task, agent, budget)])

    def every(self) -> Iterator[Result]:
        """Yield all runs, file by file. Raises FileError."""
        for budget in BudgetName:
            for path in sorted((self.folder / budget).glob("*.jsonl")):
                yield from self._runs(path).values()

    def save(self, result: Result) -> None:
        """Append a result to its file, after a line that was cut off too. Raises FileError."""
        path = self.path(result.name.task, result.name.budget)
        line = json.dumps(result.model_dump(), allow_nan=False) + "\n"
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            with path.open("a+b") as file:
                if file.seek(0, os.SEEK_END) and file.seek(-1, os.SEEK_END) and file.read(1) != b"\n":
                    line = f"\n{line}"
                file.write(line.encode())
                file.flush()
                os.fsync(file.fileno())
        except OSError as error:
            raise FileError(f"{path}: cannot be written: {error.strerror}") from error
        self._read.pop(path, None)

    def _runs(self, path: Path) -> dict[tuple[str, int], Result]:
        if path not in self._read:
            self._read[path] = _load(path) if path.is_file() else {}
        return self._read[path]


def _load(path: Path) -> dict[tuple[str, int], Result]:
    found = {}
    for number, line in enumerate(read_text(path).splitlines(), start=1):
        try:
            result = Result.model_validate(json.loads(line))
        except (ValueError, ValidationError) as error:
            raise FileError(f"{path}: line {number} is damaged or is no run; delete the line") from error
        if (result.name.budget, result.name.task) != (path.parent.name, path.stem) or path.stem not in TASKS:
            raise FileError(f"{path}: line {number} is the run {result.name}, which belongs to another file")
        found[result.name.agent, result.name.seed] = result
    return found


class Group(NamedTuple):
    """The runs of a task, an agent and a budget, one for each seed from 0 on."""

    task: str
    agent: str
    budget: BudgetName
    runs: int


def grid(budget: BudgetName) -> Iterator[Group]:
    """Yield all groups of a budget."""
    for name, task in TASKS.items():
        agents: Sequence[str] = PAPERS if isinstance(task, Benchmark) else PAPERS[:1]
        if budget in _OTHERS:
            tasks, agents = _OTHERS[budget]
            if name not in tasks:
                continue
        seeds = _PARKING_SEEDS if (name, budget) == ("parking", BudgetName.PUBLISHED) else _SEEDS
        yield from (Group(name, agent, budget, seeds) for agent in agents)


def select(
    tasks: Sequence[str] | None,
    agents: Sequence[str] | None,
    seeds: Sequence[int] | None,
    budget: BudgetName = BudgetName.PUBLISHED,
) -> list[RunName]:
    """Return the selected runs of a budget, circuits first: of the grid, or of any seeds given.

    Raises UsageError for an unknown task or agent, and where nothing is left.
    """
    for what, given, known in (("task", tasks, tuple(TASKS)), ("agent", agents, AGENTS)):
        for name in set(given or ()) - set(known):
            raise UsageError(f"no {what} {name!r}; expected one of {', '.join(known)}")
    groups = sorted(grid(budget), key=lambda group: AGENTS.index(group.agent))
    names = [
        RunName(task=group.task, agent=group.agent, seed=seed, budget=budget)
        for group in groups
        if group.agent in (agents or AGENTS) and group.task in (tasks or TASKS)
        for seed in dict.fromkeys(seeds or range(group.runs))
    ]
    if not names:
        raise UsageError(f"the budget {budget} has no such runs; python -m paper report --long lists them")
    return names


def budget_for(task: Task, name: BudgetName, agent: str = "circuit") -> Budget:
    """Return the budget of a search: the paper's, or one of seconds."""
    if agent in NETWORKS:
        budget = Budget(*_NETWORK_SETTINGS)
    else:
        iterations, rollouts, worst = task.settings
        strategy = "algorithm1" if name is BudgetName.ALGORITHM1 else task.published_search
        budget = Budget(rollouts, worst, strategy, iterations, task.warm_up)
    return replace(budget, iterations=_QUICK_ITERATIONS) if name is BudgetName.QUICK else budget


def train_run(name: RunName) -> Result:
    """Make one run. The same name gives the same parameters and returns, to the last bit.

    Raises UsageError.
    """
    task, began, cpu = TASKS[name.task], time.monotonic(), time.process_time()
    made = _made_with(task, name.agent)  # before the search: files may change while it lasts
    if isinstance(task, Benchmark) and name.agent in GRADIENTS:
        agent, (found, settings) = None, train_actor(task, name.agent, name.seed)
    else:
        agent, budget = build_agent(task, name.agent, name.seed), budget_for(task, name.budget, name.agent)
        found, settings = run_search(task, agent, name.seed, budget), vars(budget)
    return Result(
        name=name,
        settings=settings,
        made_with=made,
        wall_s=time.monotonic() - began,
        cpu_s=time.process_time() - cpu,
        evaluations=found.evaluations,
        steps=found.steps,
        curve=found.curve,
        parameters=Packed.of(found.vector),
        **score(task, agent, found.vector, name.seed, settings.get("warm_up", 0)).model_dump(),
    )


def _made_with(task: Task, agent: str) -> dict[str, str]:
    libraries = ["stable-baselines3", "torch"] if agent in GRADIENTS else []
    if isinstance(task, Benchmark):
        libraries += ["gymnasium", "mujoco"] if task.model else ["gymnasium"]
    return _source() | {library: metadata.version(library) for library in libraries}


def score(task: Task, agent: Policy | Net | None, vector: Vector, seed: int, warm_up: int) -> Score:
    """Return the score of parameters (P,) in fresh episodes.

    Without an agent, the parameters are those of an actor (``gradients.py``). Parking is
    deterministic: one episode is enough.
    """
    if not isinstance(task, Benchmark):
        assert isinstance(agent, Policy)
        total, parked = ParkingEvaluator(task, agent).outcome(vector)
        success = parked and total >= task.success
        return Score(episodes=1, mean=total, std=0.0, plain_mean=total, success=success)
    seeds = draw_seeds(seed, (_FINAL,), _EPISODES)
    if agent is None:
        returns, plain = score_actor(task, vector, seeds)
    else:
        evaluator = PlantEvaluator(task, agent, warm_up=warm_up)
        found = evaluator.run(np.tile(vector, (_EPISODES, 1)), seeds)
        returns, plain = found[:, :2].sum(axis=1), found[:, 0]
    plain_mean = float(plain.mean())
    return Score(
        episodes=_EPISODES,
        mean=float(returns.mean()),
        std=float(returns.std()),
        plain_mean=plain_mean,
        success=plain_mean >= task.success,
    )


def replay(result: Result) -> Score:
    """Return the score of a stored run's parameters now."""
    name, task = result.name, TASKS[result.name.task]
    agent = None if name.agent in GRADIENTS else build_agent(task, name.agent, name.seed)
    return score(task, agent, result.parameters.array(), name.seed, result.settings.get("warm_up", 0))


def agrees(result: Result, replayed: Score) -> bool:
    """Whether a replay has the stored verdict, and returns within ``TOLERANCE`` except a half-cheetah's."""
    pairs = ((now, getattr(result, field)) for field, now in replayed)
    close = all(math.isclose(now, stored, rel_tol=TOLERANCE, abs_tol=TOLERANCE) for now, stored in pairs)
    return replayed.success == result.success and (close or result.name.task == "half-cheetah")


def make_runs(
    names: Sequence[RunName], store: ResultStore, processes: int | None, on_result: Callable[[Result], None]
) -> None:
    """Make runs, as many at once as there are processes; save each as it ends.

    An interruption loses the unfinished ones. Raises UsageError before the first run begins.
    """
    if {name.agent for name in names} & set(GRADIENTS) and not find_spec("stable_baselines3"):
        raise UsageError("ppo and a2c need stable-baselines3: make paper-gradients installs it")
    library()
    count = min(processes or os.cpu_count() or 1, len(names))
    # Spawned, never forked: cffi does not survive a fork.
    with ProcessPoolExecutor(count, multiprocessing.get_context("spawn"), end_with_parent) as workers:
        try:
            for run in as_completed([workers.submit(train_run, name) for name in names]):
                result = run.result()
                store.save(result)
                on_result(result)
        finally:  # or an error and Ctrl-C would wait for all runs, and lose them
            workers.shutdown(wait=False, cancel_futures=True)
