"""The paper's searches, the loop that they share, the estimate of their candidates, and their saved state.

The published code has a search for each task. On parking, which has no chance, it never estimates the
incumbent anew; MLP and LSTM have one of their own. That of cart-pole is in an older commit of the published
code (529dae8), where an estimate counts as an iteration. ``tests/kit/paper_reference.py`` has all of them
literally; this loop makes the same decisions in less time.
"""

import json
import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from paper.episodes import PlantEvaluator
from paper.tasks import TASKS, Benchmark, Net, Task, Vector, draw_seeds, rng_of
from rover_ncp.circuit.policy import Policy
from rover_ncp.core.errors import FileError
from rover_ncp.core.files import read_text, write_atomic
from rover_ncp.course.course import load_course
from sim.learn.evaluator import Evaluator
from sim.learn.search import Batch
from sim.learn.search.algorithm1 import Algorithm1
from sim.learn.search.published import FAILURES_TO_WIDEN, RULES, Published
from sim.learn.search.random_search import Scale, Strategy

_SEARCH, _ROLLOUTS = 0, 1
"""Streams of random numbers: of a search, and of the episodes that estimate its candidates."""
_SAVE_STEPS = 1_500_000
"""Steps of the environment between two states that are saved."""
_STOPS = (1, 3, 5, 7, 9)
"""Rollouts after which a candidate may be stopped."""
_MIN_AHEAD, _MAX_AHEAD = 3, 48
_CAR_RULES, _CART_RULES = ({**RULES, **TASKS[task].rules} for task in ("mountain-car", "cart-pole"))
_FALLS_BACK = {16: 12}
"""Cap of a car's weights from which it falls back instead of growing, and to which."""
_MIN_AMPLITUDE, _MAX_AMPLITUDE = 0.01, 1.0
"""Of a network's noise."""


class PublishedOnNetworks:
    """The published search of MLP and LSTM: noise of one amplitude on all weights, which have no bounds."""

    counts_estimates = False
    start = Scale(_MIN_AMPLITUDE)

    def first(self, defaults: Vector, rng: np.random.Generator) -> Vector:
        """Return noise alone."""
        return _MIN_AMPLITUDE * rng.standard_normal(len(defaults))

    def propose(self, incumbent: Vector, level: Any, rng: np.random.Generator) -> Vector:
        """Add noise to all weights."""
        candidate: Vector = incumbent + level * rng.standard_normal(len(incumbent))
        return candidate

    def after(self, success: bool, scale: Scale) -> Scale:
        """Halve the amplitude after a success; the 51st failure in a row makes it five times as large."""
        if success:
            return Scale(max(scale.level / 2.0, _MIN_AMPLITUDE))
        if scale.failures + 1 < FAILURES_TO_WIDEN:
            return Scale(scale.level, scale.failures + 1)
        return Scale(min(scale.level * 5.0, _MAX_AMPLITUDE), due=True)


STRATEGIES: Mapping[str, Callable[..., Strategy]] = {
    "published-parking": partial(Published, estimates=False),
    "published-benchmarks": Published,
    "published-mountain-car": partial(Published, rules=_CAR_RULES, falls_back=_FALLS_BACK),
    "published-cart-pole": partial(Published, rules=_CART_RULES, counts_estimates=True),
    "algorithm1": Algorithm1,
    "algorithm1-parking": partial(Algorithm1, estimates=False),
}


@dataclass(frozen=True)
class Budget:
    """A search (of circuits, a name of ``STRATEGIES``), its iterations, and its estimate's settings."""

    rollouts: int
    worst: int
    strategy: str
    iterations: int
    warm_up: int = 0
    """Ticks of the agent on the first observation before an episode's first step."""
    numbers: Mapping[str, float] = field(default_factory=dict)
    """Of Algorithm 1: alpha and the first sigma."""


Point = tuple[int, int, float]
"""A change of an incumbent's estimate: iterations, environment steps, estimate."""


class Found(NamedTuple):
    """Result of a search: parameters (P,), environment steps, and the learning curve."""

    vector: Vector
    steps: int
    curve: tuple[Point, ...] = ()


class Progress(NamedTuple):
    """A search between two batches of candidates: all that it needs to go on."""

    incumbent: Vector
    scale: Scale
    random: Mapping[str, Any]
    """State of the random numbers."""
    value: float = math.nan
    """Estimate of the incumbent."""
    evaluations: int = 0
    done: int = 0
    """Iterations."""
    ahead: int = 1
    """How many candidates the next batch has."""


class BenchmarkEstimator(PlantEvaluator):
    """The paper's estimate on a benchmark: the mean of the worst k of N rollouts."""

    def __init__(self, task: Benchmark, agent: Policy | Net, seed: int, budget: Budget) -> None:
        super().__init__(task, agent, for_search=True, warm_up=budget.warm_up)
        self.max_ahead = _MAX_AHEAD if self.pool is None else 1  # MuJoCo's lanes save no time
        self._seed, self._rollouts, self._worst = seed, budget.rollouts, budget.worst

    def estimate(self, vectors: Vector, number: int, to_beat: float) -> Vector:
        """Return the estimates (k,) of vectors (k, P); ``number`` is that of the first among all evaluations.

        A candidate takes no more rollouts once it cannot exceed ``to_beat`` even if all others returned the
        most. Where no return is the most, that can be so once it has as many rollouts as are averaged.
        """
        count, rollouts, most = len(vectors), self._rollouts, self.task.most
        seeds = np.array(
            [draw_seeds(self._seed, (_ROLLOUTS, number + place), rollouts) for place in range(count)]
        )
        returns = np.full((count, rollouts), most)
        estimates = np.full(count, np.inf)
        left, done = np.arange(count), 0
        first = 1 if most < math.inf else self._worst
        early = [stop for stop in _STOPS if first <= stop < rollouts]
        for stop in (*early, rollouts):
            found = self.run(np.repeat(vectors[left], stop - done, axis=0), seeds[left, done:stop].ravel())
            returns[left, done:stop] = found[:, :2].sum(axis=1).reshape(len(left), -1)
            lowest = np.sort(returns[left], axis=1)[:, : self._worst]
            estimates[left] = [math.fsum(row) / self._worst for row in lowest]
            left, done = left[estimates[left] > to_beat], stop
            if not len(left):
                break
        return estimates


class ParkingEvaluator:
    """Scores parameter vectors of a circuit by the course, without chance. One thread at a time."""

    max_ahead = _MAX_AHEAD

    def __init__(self, task: Task, policy: Policy) -> None:
        self.task, self.steps = task, 0
        self._stream = Evaluator(policy, load_course("parking")).stream(1)

    def estimate(self, vectors: Vector, number: int, to_beat: float) -> Vector:
        """Return the returns (k,) of vectors (k, P), exact only above ``to_beat``.

        Without chance, the ``number`` of an evaluation does not matter.
        """
        count = self.task.distance_of
        self.steps += len(vectors) * self.task.horizon
        self._stream.submit(0, Batch(vectors, np.full(len(vectors), -math.inf if count else to_beat)))
        [(_, scores)] = self._stream.collect()
        if count:
            distances: Vector = np.linalg.norm(scores.residuals[..., :count], axis=2).sum(axis=1)
            return -distances
        return scores.returns.copy()


def climb(
    strategy: Strategy,
    progress: Progress,
    iterations: int,
    estimate: Callable[[Vector, int, float], Vector],
    max_ahead: int = _MAX_AHEAD,
) -> Iterator[Progress]:
    """Maximise an estimate; yield the progress after each batch of candidates.

    Candidates are drawn ahead, as if those before them had failed. After a success those behind it are
    dropped, and the random numbers continue where they were when it was drawn. So the decisions are those of
    one candidate after the other.
    """
    rng = np.random.Generator(np.random.PCG64())
    rng.bit_generator.state = progress.random
    incumbent, scale, _, value, evaluations, done, ahead = progress
    while not evaluations or done < iterations:
        before = value
        if not evaluations or scale.due:
            value = float(estimate(incumbent[None], evaluations, -math.inf)[0])
            if not math.isfinite(value):
                raise ValueError(f"the incumbent's return is {value}: no candidate could be compared with it")
            done += strategy.counts_estimates and evaluations > 0
            evaluations += 1
            scale = scale._replace(due=False)
        else:
            drawn: list[tuple[Vector, Scale, Any]] = []
            coming = scale
            while len(drawn) < min(ahead, iterations - done) and not coming.due:
                vector = strategy.propose(incumbent, coming.level, rng)
                drawn.append((vector, coming, rng.bit_generator.state))
                coming = strategy.after(False, coming)
            found = estimate(np.array([vector for vector, _, _ in drawn]), evaluations, value)
            for (vector, used, state), new in zip(drawn, found.tolist(), strict=True):
                evaluations, done = evaluations + 1, done + 1
                if new > value:
                    incumbent, value, scale = vector, new, strategy.after(True, used)
                    rng.bit_generator.state = state
                    break
                scale = strategy.after(False, used)
        ahead = min(2 * ahead if value == before else _MIN_AHEAD, max_ahead)
        yield Progress(incumbent, scale, rng.bit_generator.state, value, evaluations, done, ahead)


class SavedSearch:
    """The file of an unfinished search, written about once a minute on the half-cheetah.

    A search goes on only with the settings and the source that began it.
    """

    def __init__(self, path: Path, origin: Mapping[str, Any], clock: Callable[[], float]) -> None:
        """``clock`` returns the process's CPU time, s."""
        self.path, self._origin, self._clock = path, json.loads(json.dumps(origin)), clock
        self._began_s, self._saved_steps = clock(), 0

    @property
    def cpu_s(self) -> float:
        """CPU time of this process since now, and of those before it."""
        return self._clock() - self._began_s

    def load(self) -> tuple[Progress, int, list[Point]] | None:
        """Return progress, environment steps and curve. Raises FileError if another source saved them."""
        if not self.path.is_file():
            return None
        text = json.loads(read_text(self.path))
        if text["origin"] != self._origin:
            raise FileError(
                f"{self.path}: another version or other settings began this run ({text['origin']}): go on "
                "with those, or delete the file to begin anew"
            )
        self._began_s, self._saved_steps = self._began_s - text["cpu_s"], text["steps"]
        incumbent, scale, *others = text["progress"]
        curve = [tuple(point) for point in text["curve"]]
        return Progress(np.array(incumbent), Scale(*scale), *others), text["steps"], curve

    def save(self, progress: Progress, steps: int, points: Iterable[Point]) -> None:
        """Write the file if the environment has made many steps since the last time. Raises FileError."""
        if steps >= self._saved_steps + _SAVE_STEPS:
            state = progress._replace(incumbent=progress.incumbent.tolist())
            text = {"origin": self._origin, "cpu_s": self.cpu_s, "progress": state, "steps": steps}
            write_atomic(self.path, json.dumps(text | {"curve": list(points)}))
            self._saved_steps = steps


def run_search(
    task: Task, agent: Policy | Net, seed: int, budget: Budget, saved: SavedSearch | None = None
) -> Found:
    """Search an agent's parameters from one incumbent. The same arguments give the same bits.

    With ``saved`` it goes on where it was saved last, to the same bits too.
    """
    place: BenchmarkEstimator | ParkingEvaluator
    if isinstance(task, Benchmark):
        place = BenchmarkEstimator(task, agent, seed, budget)
    else:
        assert isinstance(agent, Policy)
        place = ParkingEvaluator(task, agent)
    if isinstance(agent, Policy):
        strategy, defaults = STRATEGIES[budget.strategy](agent.layout(), **budget.numbers), agent.parameters()
    else:
        strategy, defaults = PublishedOnNetworks(), np.zeros(sum(agent.sizes))
    rng = rng_of(seed, (_SEARCH,))
    progress = Progress(strategy.first(defaults, rng), strategy.start, rng.bit_generator.state)
    points: dict[int, Point] = {}
    if saved is not None and (last := saved.load()):
        progress, place.steps, curve = last
        points = {mark(point[0]): point for point in curve}
    for now in climb(strategy, progress, budget.iterations, place.estimate, place.max_ahead):
        if now.value != progress.value:
            points[mark(now.done)] = now.done, place.steps, now.value
        progress = now
        if saved is not None:
            saved.save(progress, place.steps, points.values())
    return Found(progress.incumbent, place.steps, tuple(points.values()))


def mark(iterations: int) -> int:
    """Round up to two digits; a curve keeps the last change before each such number."""
    scale: int = 10 ** max(len(str(iterations)) - 2, 0)
    return -(-iterations // scale) * scale
