"""The loop of the paper's searches, and the checkpoint of an unfinished one."""

import json
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from rover_ncp.circuit.policy import Policy
from rover_ncp.core.files import write_atomic
from sim.learn.engine.networks import Net
from sim.learn.run_folder import dump_checked, load_checked
from sim.learn.search.base import Vector
from sim.paper.search.estimate import BenchmarkEstimator, Budget, ParkingEvaluator
from sim.paper.search.published import SEARCHES
from sim.paper.tasks import Benchmark, Task

_SEARCH = 0
"""Stream of random numbers; another one is that of ``estimate.py``."""
_MIN_AHEAD, _MAX_AHEAD = 3, 48


class Point(NamedTuple):
    """A change of the incumbent's estimate, and the iterations and environment steps before it."""

    iterations: int
    steps: int
    value: float


@dataclass(frozen=True, eq=False)
class Found:
    """Result of a search: parameters (P,), evaluations, environment steps, and the learning curve."""

    vector: Vector
    evaluations: int
    steps: int
    curve: tuple[Point, ...] = ()


class Checkpoint:
    """The saved state of an unfinished run, or none; it holds all that a continued run depends on."""

    def __init__(self, path: Path | None, settings: dict[str, Any], every_s: float = 300.0) -> None:
        self._path, self._every_s = path, every_s
        self._owner = f"{path and path.name}\n{json.dumps(settings)}"
        self._began = np.array([time.monotonic(), time.process_time()])
        self._saved = time.monotonic()

    def load(self) -> dict[str, Any] | None:
        """Return the state that was saved last. Raises FileError for a damaged file, or of another run."""
        if self._path is None or not self._path.is_file():
            return None
        data = load_checked(self._path, self._owner)
        self._began -= data["times"]
        state: dict[str, Any] = data["search"]
        return state

    def times(self) -> list[float]:
        """Return wall time and CPU time in s, those before an interruption included."""
        times: list[float] = ([time.monotonic(), time.process_time()] - self._began).tolist()
        return times

    def save(self, state: Callable[[], dict[str, Any]]) -> None:
        """Write a state if the last one is old. Raises FileError."""
        if self._path is None or time.monotonic() - self._saved < self._every_s:
            return
        write_atomic(self._path, dump_checked({"times": self.times(), "search": state()}, self._owner))
        self._saved = time.monotonic()


def run_search(task: Task, agent: Policy | Net, seed: int, budget: Budget, checkpoint: Checkpoint) -> Found:
    """Search an agent's parameters from one incumbent. The same arguments give the same bits.

    Raises FileError if the state of an interrupted run does not fit.
    """
    estimator: BenchmarkEstimator | ParkingEvaluator
    if isinstance(task, Benchmark):
        estimator = BenchmarkEstimator(task, agent, seed, budget)
    else:
        assert isinstance(agent, Policy)
        estimator = ParkingEvaluator(task, agent)
    generator = np.random.Generator(np.random.PCG64(np.random.SeedSequence(seed, spawn_key=(_SEARCH,))))
    first = agent.parameters() if isinstance(agent, Policy) else agent.start(generator)
    search = SEARCHES[budget.strategy].begin(agent.layout(), first, generator)
    curve: list[Point] = []
    ahead = _MIN_AHEAD
    if saved := checkpoint.load():
        search.restore(saved["search"])
        curve = [Point(*point) for point in saved["curve"]]
        ahead, estimator.steps = int(saved["ahead"]), int(saved["steps"])

    def state() -> dict[str, Any]:
        return {"search": search.state(), "curve": curve, "ahead": ahead, "steps": estimator.steps}

    while search.iterations < budget.iterations:
        number, before = search.evaluations, search.value
        vectors = search.ask(min(ahead, budget.iterations - search.iterations))
        search.tell(estimator.estimate(vectors, number, search.to_beat))
        assert search.value is not None
        if search.value != before:
            curve.append(Point(search.iterations, estimator.steps, search.value))
        ahead = min(2 * ahead, _MAX_AHEAD) if search.value == before else _MIN_AHEAD
        checkpoint.save(state)
    return Found(search.incumbent, search.evaluations, estimator.steps, tuple(curve))
