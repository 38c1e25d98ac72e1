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

from paper.episodes import Evaluator
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
    find_task,
)
from rover_ncp.circuit.policy import Policy
from rover_ncp.core.config import StrictModel
from rover_ncp.core.errors import FileError, RoverNcpError, UsageError
from rover_ncp.core.files import read_text
from sim.learn.record import made_with

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
_GRADIENT_TASKS = ("pendulum", "mountain-car")
"""The tasks of the paper's table of reinforcement learning."""
_ALGORITHM1_TASKS = ("parking", "pendulum", "mountain-car", "cart-pole")
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
        """Yield all runs, file by file. Raises FileError; OSError for a folder that cannot be read."""
        for budget in BudgetName:
            try:  # since Python 3.13, glob finds nothing where a folder cannot be read
                paths = sorted((self.folder / budget).iterdir())
            except FileNotFoundError:
                continue
            for path in paths:
                if path.suffix == ".jsonl":
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
        if (result.name.budget, result.name.task) != (path.parent.name, path.stem):
            raise FileError(f"{path}: line {number} is the run {result.name}, which belongs to another file")
        found[result.name.agent, result.name.seed] = result
    return found


class Group(NamedTuple):
    """The runs of a task, an agent and a budget, one for each seed from 0 on."""

    task: str
    agent: str
    budget: BudgetName
    runs: int = _SEEDS

    def names(self, seeds: Sequence[int] | None = None) -> list[RunName]:
        """Return the group's runs, or those of the seeds given."""
        return [
            RunName(task=self.task, agent=self.agent, seed=seed, budget=self.budget)
            for seed in dict.fromkeys(seeds or range(self.runs))
        ]


def grid(*budgets: BudgetName) -> Iterator[Group]:
    """Yield all groups of some budgets."""
    for budget in budgets:
        for name, task in TASKS.items():
            seeds = _PARKING_SEEDS if (name, budget) == ("parking", BudgetName.PUBLISHED) else _SEEDS
            yield from (Group(name, agent, budget, seeds) for agent in _agents(task, budget))


def _agents(task: Task, budget: BudgetName) -> Sequence[str]:
    if budget is BudgetName.GRADIENTS:
        return GRADIENTS if task.name in _GRADIENT_TASKS else ()
    if budget is BudgetName.ALGORITHM1:
        return ("circuit",) if task.name in _ALGORITHM1_TASKS else ()
    return PAPERS if isinstance(task, Benchmark) else ("circuit",)


def select(
    tasks: Sequence[str] | None,
    agents: Sequence[str] | None,
    seeds: Sequence[int] | None,
    budget: BudgetName = BudgetName.PUBLISHED,
) -> list[RunName]:
    """Return the selected runs of a budget, circuits first: of the grid, or of any seeds given.

    Raises UsageError for an unknown task or agent, and where nothing is left.
    """
    for task in tasks or ():
        find_task(task)
    for agent in agents or ():
        if agent not in AGENTS:
            raise UsageError(f"no agent {agent!r}; expected one of {', '.join(AGENTS)}")
    groups = [
        group
        for group in grid(budget)
        if (not agents or group.agent in agents) and (not tasks or group.task in tasks)
    ]
    groups.sort(key=lambda group: AGENTS.index(group.agent))
    if not groups:
        raise UsageError(
            f"the budget {budget} has no such runs; python -m paper report --long lists those of each budget"
        )
    return [name for group in groups for name in group.names(seeds)]


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
    task, began, cpu = find_task(name.task), time.monotonic(), time.process_time()
    made = _made_with(task, name.agent)  # before the search: files may change while it lasts
    agent: Policy | Net | None = None
    settings: dict[str, Any]
    if name.agent in GRADIENTS:
        assert isinstance(task, Benchmark)
        found, settings = train_actor(task, name.agent, name.seed)
    else:
        agent = build_agent(task, name.agent, name.seed)
        budget = budget_for(task, name.budget, name.agent)
        settings, found = vars(budget), run_search(task, agent, name.seed, budget)
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
        evaluator = Evaluator(task, agent, warm_up=warm_up)
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
    name = result.name
    agent: Policy | Net | None = None
    task = find_task(name.task)
    if name.agent not in GRADIENTS:
        agent = build_agent(task, name.agent, name.seed)
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

    An interruption loses the unfinished ones. Raises UsageError before the first run begins; after the
    others, the error of a run.
    """
    if {name.agent for name in names} & set(GRADIENTS) and not find_spec("stable_baselines3"):
        raise UsageError("ppo and a2c need stable-baselines3: make paper-gradients installs it")
    count = min(processes or len(os.sched_getaffinity(0)), len(names))
    errors: list[RoverNcpError] = []
    # Spawned, never forked: numba does not survive a fork.
    with ProcessPoolExecutor(count, multiprocessing.get_context("spawn")) as workers:
        for run in as_completed([workers.submit(train_run, name) for name in names]):
            try:
                result = run.result()
            except RoverNcpError as error:  # the others go on
                errors.append(error)
                continue
            store.save(result)
            on_result(result)
    if errors:
        raise errors[0]
