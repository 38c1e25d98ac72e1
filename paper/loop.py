"""The loop of the paper's searches, the estimate of their candidates, and the checkpoint of a search."""

import json
import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from paper.evaluator import Evaluator
from paper.networks import Net
from paper.searches import SEARCHES
from paper.tasks import Benchmark, Task
from rover_ncp.circuit.policy import Policy
from rover_ncp.core.files import write_atomic
from rover_ncp.course.course import load_course
from sim.learn.engine import evaluator as engine
from sim.learn.run_folder import dump_checked, load_checked
from sim.learn.search.base import Vector, draw_seeds

_SEARCH, _ROLLOUTS = 0, 1
"""Streams of random numbers."""
_STOPS = (1, 3, 9)
"""Rollouts after which a candidate may be stopped."""
_CHECKPOINT_S = 300.0
_MIN_AHEAD, _MAX_AHEAD = 3, 48


@dataclass(frozen=True)
class Budget:
    """A search (a name of ``SEARCHES`` in ``published.py``), its iterations, and its estimate's settings."""

    rollouts: int
    worst: int
    strategy: str
    iterations: int
    warm_up: int = 0
    """Ticks of the agent on the first observation before an episode's first step."""


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


class BenchmarkEstimator(Evaluator):
    """The paper's estimate on a benchmark: the mean of the worst k of N rollouts."""

    def __init__(self, task: Benchmark, agent: Policy | Net, seed: int, budget: Budget) -> None:
        super().__init__(task, agent, for_search=True, warm_up=budget.warm_up)
        self._seed, self._rollouts, self._worst = seed, budget.rollouts, budget.worst

    def estimate(self, vectors: Vector, number: int, to_beat: Vector) -> Vector:
        """Return the estimates (k,) of vectors (k, P); ``number`` is that of the first among all evaluations.

        A candidate takes no more rollouts once it cannot exceed ``to_beat`` (k,), as if all others returned
        the most.
        """
        count, rollouts, most = len(vectors), self._rollouts, self.task.most
        seeds = np.array(
            [draw_seeds(self._seed, (_ROLLOUTS, number + place), rollouts) for place in range(count)]
        )
        returns = np.full((count, rollouts), most)
        estimates = np.full(count, np.inf)
        left, done = np.arange(count), 0
        early = [stop for stop in _STOPS if stop < rollouts] if most < math.inf else []
        for stop in (*early, rollouts):
            found = self.run(np.repeat(vectors[left], stop - done, axis=0), seeds[left, done:stop].ravel())
            returns[left, done:stop] = found[:, :2].sum(axis=1).reshape(len(left), -1)
            lowest = np.sort(returns[left], axis=1)[:, : self._worst]
            estimates[left] = [math.fsum(row) / self._worst for row in lowest]
            left, done = left[estimates[left] > to_beat[left]], stop
            if not len(left):
                break
        return estimates


class ParkingEvaluator:
    """Scores parameter vectors of a circuit by the course, without chance. One thread at a time."""

    def __init__(self, task: Task, policy: Policy) -> None:
        self.task, self.steps = task, 0
        self._engine = engine.Evaluator(policy, load_course("parking"))
        self._stream = self._engine.stream(1)

    def outcome(self, vector: Vector) -> tuple[float, bool]:
        """Return the return of parameters (P,) and whether they park."""
        found = self._engine.outcomes(vector)
        return float(found.total[0, 0]), bool(found.parked[0, 0])

    def estimate(self, vectors: Vector, number: int, to_beat: Vector) -> Vector:
        """Return the returns (k,) of vectors (k, P), exact only above ``to_beat`` (k,).

        Without chance, the ``number`` of an evaluation does not matter.
        """
        self.steps += len(vectors) * self.task.horizon
        self._stream.submit(0, vectors, to_beat)
        [answer] = self._stream.collect()
        return answer.returns.copy()


class Checkpoint:
    """The saved state of an unfinished run, or none; it holds all that a continued run depends on."""

    def __init__(self, path: Path | None, settings: dict[str, Any]) -> None:
        """``settings`` are the run's, with the commit and the libraries: other ones refuse its state."""
        self._path = path
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
        if self._path is None or time.monotonic() - self._saved < _CHECKPOINT_S:
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
    first = agent.parameters() if isinstance(agent, Policy) else np.zeros(agent.layout().size)
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
