"""Training on randomised robots: CMA-ES on the mean of a smooth cost over random trials and courses.

A generation's candidates all drive the same trials (common random numbers), so that chance does not separate
them. The next generation drives other trials, which prevents overfitting. Early generations drive fewer
trials: far from the goal a rough estimate suffices, and close to it a good one is needed. A generation
depends on its number, never on the number of later ones. The winner is the average of the distribution's last
means, which depends on no single lucky trial.

Parameters are searched in the unit box, at whose walls the search is reflected.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from itertools import repeat
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from cmaes import CMA
from numpy.typing import NDArray
from pydantic import Field

from rover_ncp.circuit.compiled import dead_parameters
from rover_ncp.circuit.policy import Policy
from rover_ncp.core.config import StrictModel
from rover_ncp.core.streams import Domain, integer_seed, stream_seed
from rover_ncp.course.course import Course, ParkedRule
from rover_ncp.course.reference import Reference, plan_reference
from sim.learn.evaluator import Evaluator, Outcomes
from sim.learn.folder import open_run
from sim.learn.search.unit_box import UnitBox, reflected
from sim.learn.settings import RobustSettings, Task, load_task
from sim.learn.workers import Map, available_processes, local_workers, made_in_each_process
from sim.world.random_course import mirrored, mirrored_reference, random_course
from sim.world.randomization import Randomization, draw_trials
from sim.world.rover import RoverModel

FloatArray = NDArray[np.float64]

_STATE = "search.json"
"""File of the search between two generations."""


class Stage(NamedTuple):
    """How the generations from number ``since`` on are driven and judged."""

    since: int
    divisor: int
    """Candidates drive the rollouts divided by this."""
    min_sigma: float
    """Lower bound of sigma: with noisy costs CMA-ES shrinks it too early."""
    failure: float
    limit: float
    blur: float
    """The cost of a failure, its limit in m and rad by the usual rule, and the width of the smooth limit."""
    rounded: bool
    """Whether commands come in whole steps, in trials that have them, every other generation."""


class Schedule(NamedTuple):
    """How a search goes: its stages, the first step size (sigma) and the greatest."""

    stages: Sequence[Stage]
    first_sigma: float
    max_sigma: float
    """Where all costs are equal, noise would let sigma grow beyond the box."""
    kept: float = 0.0
    """Share of the start in the winner, which lies between it and what was found (Wortsman et al. 2022)."""


_STAGES = (
    Stage(0, 16, 0.01, 6.0, 0.09, 0.012, False),
    Stage(150, 8, 0.01, 6.0, 0.09, 0.012, False),
    Stage(900, 4, 0.01, 6.0, 0.09, 0.012, False),
    Stage(1750, 4, 0.01, 20.0, 0.095, 0.004, False),
    Stage(2000, 1, 0.004, 20.0, 0.095, 0.004, False),
    Stage(2400, 1, 0.004, 20.0, 0.095, 0.004, True),
)
"""The first stages reach the goal's neighbourhood, the next ones park always, and the last ones park the last
few of a hundred, which takes many trials to see and small steps. Quantised commands come last, and only in
some generations: they hide the small twitches of a motor neuron that should be at rest. A policy trained with
nothing else twitches on bases without quantisation."""

TRAINING = Schedule(_STAGES, 0.04, 0.1)
REFINING = Schedule(
    (
        Stage(0, 2, 0.00375, 6.0, 0.09, 0.012, False),
        Stage(300, 1, 0.0015, 20.0, 0.095, 0.006, False),
        Stage(405, 1, 0.0015, 20.0, 0.095, 0.006, True),
    ),
    0.015,
    0.05,
    0.35,
)
"""For a trained policy: it parks already, and large steps or few trials would lose what it has. What is found
is better at the new trials and worse at others; between it and the start, both are kept."""

_USUAL_RULE = ParkedRule()
"""The limits of stages are for its 0.1 m and 0.1 rad."""

Drive = Callable[[FloatArray, int, int, Stage], FloatArray]
"""Vectors (k, P), the first trial, how many, and the stage: the costs (k, trials)."""

_POPULATION = 1.8
"""Candidates, times the usual number: what is measured is noisy."""
_STILL = (0.6, 0.12)
"""Motion, as a share of the rule's, above which a rover that should stand has failed, and the width of the
smooth limit: well within the rule's, as large twitches are rare, and small ones that show them are not."""
_AVERAGED, _AVERAGED_SHARE = 100, 4
"""The winner is the average of so many last means, yet of no more than that fraction of all."""
_RANDOM_BETWEEN = 2
"""The number of random courses after each turn of the given one, which goes to the left and to the right."""


def policy_box(policy: Policy) -> UnitBox:
    """Return the search space of a policy; the parameters of sensory neurons are inert and stay."""
    return UnitBox.of(policy.layout(), policy.parameters(), dead_parameters(policy))


def costs(found: Outcomes, stage: Stage = _STAGES[0], rule: ParkedRule = _USUAL_RULE) -> FloatArray:
    """Return a cost (candidates, trials) of each episode: smooth, and steepest where parked ends.

    Errors count by the logarithm, so that a lost trial does not outweigh many good ones. The limits of parked
    are the rule's, a little tightened and blurred. A trial with a contact has failed.
    """
    near = (
        _log_square(found.error_m / rule.position_m)
        + _log_square(found.error_rad / rule.heading_rad)
        + _log_square(found.moved_m / rule.still_m)
        + _log_square(found.turned_rad / rule.still_rad)
    )
    on_the_way = 0.2 * np.log1p(found.tracking_m2 / 0.05**2) + 0.1 * np.log1p(found.tracking_rad2 / 0.1**2)
    failed = np.maximum.reduce(
        [
            _blurred(found.error_m / (rule.position_m / _USUAL_RULE.position_m), stage.limit, stage.blur),
            _blurred(found.error_rad / (rule.heading_rad / _USUAL_RULE.heading_rad), stage.limit, stage.blur),
            _blurred(found.moved_m / rule.still_m, *_STILL),
            _blurred(found.turned_rad / rule.still_rad, *_STILL),
            found.touched.astype(np.float64),
        ]
    )
    cost: FloatArray = 0.5 * near + on_the_way + stage.failure * failed
    return cost


def _log_square(part: FloatArray) -> FloatArray:
    squared: FloatArray = np.log1p(4.0 * part * part)
    return squared


def _blurred(error: FloatArray, limit: float, width: float) -> FloatArray:
    """Return about 0 below a limit and 1 above."""
    beyond: FloatArray = 1.0 / (1.0 + np.exp(np.clip((limit - error) / width, -50.0, 50.0)))
    return beyond


def mean_of_worst(returns: Sequence[float], worst: int) -> float:
    """Return the mean of the ``worst`` lowest returns, the same bits in whatever order they come."""
    return math.fsum(sorted(returns)[:worst]) / worst


def _training_seed(seed: int) -> int:
    """Return the root seed of the courses and trials of a training, which no evaluation uses."""
    return int(stream_seed(seed, Domain.TRAINING).generate_state(1, np.uint64)[0])


def training_courses(
    given: Course, planned: Reference, seed: int, count: int
) -> tuple[list[Course], list[Reference]]:
    """Return ``count`` random courses of a seed, their references, and among them those of the given one.

    All have the rule of the given one, which also comes mirrored: a circuit, unlike a law, has to learn left
    and right apart. If ``count`` is 0, the given one comes alone.
    """
    turns = ((given, planned), (mirrored(given), mirrored_reference(planned)))
    apart, pairs = _training_seed(seed), []
    for number in range(count):
        if number % _RANDOM_BETWEEN == 0:
            pairs.append(turns[number // _RANDOM_BETWEEN % 2])
        drawn, reference = random_course(apart, number)
        pairs.append((drawn.model_copy(update={"parked": given.parked}), reference))
    pairs = pairs or [turns[0]]
    return [course for course, _ in pairs], [reference for _, reference in pairs]


def drive_trials(engine: Evaluator, ranges: Randomization, model: RoverModel, seed: int) -> Drive:
    """Return what drives the trials of a search on an engine, whose courses have one rule."""
    ticks = max(course.ticks for course in engine.courses)
    apart, rule = _training_seed(seed), engine.courses[0].parked
    unrounded = ranges.model_copy(update={"speed_step_m_s": 0.0, "turn_step_rad_s": 0.0})

    def drive(vectors: FloatArray, first: int, count: int, stage: Stage) -> FloatArray:
        now = ranges if stage.rounded else unrounded
        trials = draw_trials(now, model, apart, count=count, ticks=ticks, first=first)
        # All courses take their turn, from where the generation before ended.
        engine.change_trials(trials, first // stage.divisor)
        return costs(engine.outcomes(vectors), stage, rule)

    return drive


class SearchState(StrictModel):
    """State of a search between two generations, as its file holds it."""

    generation: int
    sigma: float
    mean: list[float]
    covariance: list[list[float]]
    path: list[float]
    sigma_path: list[float]
    """Evolution paths of the covariance and of sigma."""
    means: list[list[float]]
    """After the last generations."""
    curve: list[tuple[float, float]]
    """The lowest cost and sigma of each generation."""


# ``cmaes`` offers no state but its pickle, which lacks the random generator and must not be read from a file.
_STATE_OF_CMA = {
    "generation": "_g",
    "sigma": "_sigma",
    "mean": "_mean",
    "covariance": "_C",
    "path": "_pc",
    "sigma_path": "_p_sigma",
}


class RobustSearch:
    """A search by CMA-ES from the box's start, generation by generation.

    Every generation draws from a random stream of its own. The same seed therefore gives the same search,
    also from a restored state on.
    """

    def __init__(
        self,
        box: UnitBox,
        *,
        seed: int,
        rollouts: int,
        worst: int,
        schedule: Schedule = TRAINING,
    ) -> None:
        self._box, self._schedule, self._seed = box, schedule, seed
        self._rollouts, self._worst = rollouts, worst
        # The usual number is that of Hansen 2016, arXiv:1604.00772, eq. 48.
        self.population = round(_POPULATION * (4 + math.floor(3.0 * math.log(box.size))))
        self._cma = CMA(box.start, schedule.first_sigma, population_size=self.population)
        self._means: list[list[float]] = []
        self.curve: list[tuple[float, float]] = []
        """The lowest cost and sigma of each generation."""

    @property
    def number(self) -> int:
        """Generations done."""
        return int(self._cma.generation)

    def advance(self, drive: Drive) -> None:
        """Do one generation, whose trials are driven by ``drive``."""
        stage = self._stage(self.number)
        count, worst = self._rollouts // stage.divisor, self._worst // stage.divisor
        self._cma.reseed_rng(integer_seed(self._seed, Domain.CMA_GENERATION, self.number))
        points = np.array([self._cma.ask() for _ in range(self.population)])
        vectors = self._box.vectors(reflected(points))
        found = drive(vectors, self.number * self._rollouts, max(count, 1), stage)
        values = [-mean_of_worst((-row).tolist(), max(worst, 1)) for row in found]
        self._cma.tell(list(zip(points, values, strict=True)))
        self._cma._sigma = min(max(float(self._cma._sigma), stage.min_sigma), self._schedule.max_sigma)
        self._means = [*self._means, self._cma.mean.tolist()][-_AVERAGED:]
        self.curve.append((min(values), self._cma._sigma))

    def _stage(self, number: int) -> Stage:
        stage = [stage for stage in self._schedule.stages if stage.since <= number][-1]
        return stage._replace(rounded=stage.rounded and number % 2 == 1)

    @property
    def winner(self) -> FloatArray:
        """The vector (P,) that the search would end with now."""
        count = max(min(len(self._means), self.number // _AVERAGED_SHARE), 1)
        last = self._means[-count:] or [self._cma.mean.tolist()]
        mean = np.array([math.fsum(column) / len(last) for column in zip(*last, strict=True)])
        found = reflected(mean[None])
        winner: FloatArray = self._box.vectors(found + self._schedule.kept * (self._box.start - found))[0]
        return winner

    @property
    def state(self) -> SearchState:
        """What all further generations depend on."""
        cma = {key: np.asarray(getattr(self._cma, name)).tolist() for key, name in _STATE_OF_CMA.items()}
        return SearchState(**cma, means=self._means, curve=self.curve)

    def restore(self, state: SearchState) -> None:
        """Continue from a ``state``."""
        for key, name in _STATE_OF_CMA.items():
            value = getattr(state, key)
            setattr(self._cma, name, np.array(value) if isinstance(value, list) else value)
        # The eigenvalues are those of another covariance.
        self._cma._D = self._cma._B = None
        self._means, self.curve = list(state.means), list(state.curve)


class RobustResult(RobustSettings):
    """Result of the command."""

    generations: int = Field(description="how many were made")
    cost: float = Field(description="lowest of the last generation")
    policy: str = Field(description="its file")


def train_robust(
    settings: RobustSettings,
    out: Path,
    *,
    resume: bool = False,
    processes: int | None = None,
    on_generation: Callable[[int, float], None] = lambda number, cost: None,
) -> tuple[Path, float]:
    """Train a course-relative circuit and leave the run in the folder ``out``.

    Returns the policy's file and the lowest cost of the last generation. ``processes`` defaults to one for
    each core; it changes the speed, never the result. A run that is interrupted, however it dies, goes on
    after its last generation and ends in the same files. After each one ``on_generation`` gets its number and
    lowest cost. Raises UsageError, ConfigError or FileError, WorkerDied if one of its processes was killed,
    KeyboardInterrupt.
    """
    task = load_task(settings)
    search = RobustSearch(
        policy_box(task.policy),
        seed=settings.seed,
        rollouts=settings.rollouts,
        worst=settings.worst,
        schedule=REFINING if settings.refine else TRAINING,
    )
    with open_run(out, settings, task, resume) as folder:
        if saved := folder.read(_STATE, SearchState):
            search.restore(saved)

        def save() -> None:
            folder.write(_STATE, search.state)
            provenance = folder.record.provenance(search.number, cost=search.curve[-1][0])
            policy = task.policy.with_parameters(search.winner)
            folder.write("policy.yaml", replace(policy, provenance=provenance))
            rows = [f"{number},{best!r},{sigma!r}" for number, (best, sigma) in enumerate(search.curve, 1)]
            folder.write("curve.csv", "\n".join(["generation,cost,spread", *rows, ""]))

        left = settings.iterations - search.number
        if not left:
            save()  # a run may have died between two files
        count = min(processes or available_processes(), search.population) if left else 1
        with local_workers(count) as workers:
            make = made_in_each_process(partial(_drive, settings, task))
            for _ in range(left):
                search.advance(partial(_drive_parts, workers, count, make))
                save()
                on_generation(search.number, search.curve[-1][0])
        return folder.policy_path, search.curve[-1][0]


def _drive(settings: RobustSettings, task: Task) -> Drive:
    """Return what drives the trials of a training; it is made in each process."""
    courses, references = training_courses(
        task.course, plan_reference(task.course), settings.seed, settings.random_courses
    )
    engine = Evaluator(task.policy, courses, task.rover, references=references)
    assert task.ranges is not None  # the settings name them
    return drive_trials(engine, task.ranges, task.rover, settings.seed)


def _drive_parts(workers: Map, count: int, drive: Drive, vectors: FloatArray, *which: Any) -> FloatArray:
    """Drive trials in workers, each of which takes its part of the vectors (k, P)."""
    parts = np.array_split(vectors, count)
    return np.concatenate(list(workers(drive, parts, *map(repeat, which))))
