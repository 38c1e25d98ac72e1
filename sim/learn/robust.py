"""Training on randomised robots: CMA-ES on the mean of a smooth cost over random trials and courses.

A generation's candidates all drive the same trials (common random numbers), so that chance does not separate
them. The next generation drives other trials, which prevents overfitting. Early generations drive fewer
trials: far from the goal a rough estimate suffices, and close to it a good one is needed. A generation
depends on its number, never on the number of later ones. The winner is the average of the distribution's last
means, which depends on no single lucky trial.

Parameters are searched in the unit box, at whose walls the search is reflected.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import repeat
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rover_ncp.circuit.compiled import dead_parameters
from rover_ncp.circuit.policy import Policy, course_policy
from rover_ncp.circuit.policy_file import load_start
from rover_ncp.circuit.rover_interface import RoverInterface
from rover_ncp.core.errors import UsageError
from rover_ncp.core.streams import Domain, stream_seed
from rover_ncp.course.course import Course, ParkedRule
from rover_ncp.course.reference import Reference, plan_reference
from sim.learn.evaluator import Evaluator, Outcomes
from sim.learn.folder import open_run
from sim.learn.search.cma import Cma, default_population
from sim.learn.search.unit_box import UnitBox, reflected
from sim.learn.settings import Record, RobustSettings, course_of
from sim.learn.workers import Workers, available_processes, local_workers, made_in_each_process
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


class Generation(NamedTuple):
    """State of a search after some generations."""

    iterations: int
    """Generations done."""
    winner: FloatArray
    """(P,)."""
    sigma: float
    """Step size of CMA-ES."""
    best: float
    """Lowest cost of the generation."""

    def __str__(self) -> str:
        return f"cost {self.best:.4g}"


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


class RobustSearch:
    """A search from the box's start, generation by generation. The same seed gives the same search."""

    def __init__(
        self,
        box: UnitBox,
        *,
        seed: int,
        rollouts: int,
        worst: int,
        schedule: Schedule = TRAINING,
    ) -> None:
        self._box, self._schedule = box, schedule
        self._rollouts, self._worst = rollouts, worst
        start = box.start
        self.population = round(_POPULATION * default_population(len(start)))
        self._cma = Cma(start, schedule.first_sigma, seed=seed, population=self.population)
        self._means: list[list[float]] = []

    @property
    def number(self) -> int:
        """Generations done."""
        return self._cma.generation

    def advance(self, drive: Drive) -> Generation:
        """Do one generation, whose trials are driven by ``drive``."""
        stage = self._stage(self.number)
        self._cma.limits = stage.min_sigma, self._schedule.max_sigma
        vectors = self._box.vectors(reflected(self._cma.ask()))
        count, worst = self._rollouts // stage.divisor, self._worst // stage.divisor
        found = drive(vectors, self.number * self._rollouts, max(count, 1), stage)
        values = np.array([-mean_of_worst((-row).tolist(), max(worst, 1)) for row in found])
        self._cma.tell(values)
        self._means = [*self._means, self._cma.mean.tolist()][-_AVERAGED:]
        return Generation(self.number, self.winner, self._cma.sigma, float(values.min()))

    def _stage(self, number: int) -> Stage:
        stage = [stage for stage in self._schedule.stages if stage.since <= number][-1]
        return stage._replace(rounded=stage.rounded and number % 2 == 1)

    @property
    def episodes(self) -> int:
        """Episodes driven so far."""
        rollouts = (max(self._rollouts // self._stage(number).divisor, 1) for number in range(self.number))
        return self.population * sum(rollouts)

    @property
    def winner(self) -> FloatArray:
        """The vector (P,) that the search would end with now."""
        count = max(min(len(self._means), self.number // _AVERAGED_SHARE), 1)
        last = self._means[-count:] or [self._cma.mean.tolist()]
        mean = np.array([math.fsum(column) / len(last) for column in zip(*last, strict=True)])
        found = reflected(mean[None])
        winner: FloatArray = self._box.vectors(found + self._schedule.kept * (self._box.start - found))[0]
        return winner

    def state(self) -> dict[str, Any]:
        """Return, between two generations, all that follows depends on, as JSON can keep it."""
        return {"cma": self._cma.state(), "means": self._means}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Continue from a ``state()``."""
        self._cma.restore(state["cma"])
        self._means = state["means"]


class RobustResult(NamedTuple):
    """The trained policy, its file, and where the search stood at the end."""

    policy: Policy
    path: Path
    last: Generation


def _drive(settings: RobustSettings, start: Policy, course: Course, ranges: Randomization) -> Drive:
    """Return what drives the trials of a training; it is made in each process."""
    courses, references = training_courses(
        course, plan_reference(course), settings.seed, settings.random_courses
    )
    engine = Evaluator(start, courses, settings.rover, references=references)
    return drive_trials(engine, ranges, settings.rover, settings.seed)


def _drive_parts(workers: Workers, count: int, drive: Drive, vectors: FloatArray, *which: Any) -> FloatArray:
    """Drive trials in workers, each of which takes its part of the vectors (k, P)."""
    parts = np.array_split(vectors, count)
    return np.concatenate(list(workers.map(drive, parts, *map(repeat, which))))


def start_of(settings: RobustSettings) -> tuple[Policy, Course, Randomization]:
    """Return the policy to start from, the course and the randomization.

    Raises UsageError, ConfigError or FileError.
    """
    ranges, loaded = settings.ranges, load_start(settings.circuit)
    if settings.refine and not isinstance(loaded, Policy):
        raise UsageError(
            f"--refine needs a policy in --circuit, and {settings.circuit} is an untrained circuit"
        )
    start = loaded if isinstance(loaded, Policy) else course_policy(loaded)
    RoverInterface(start)  # raises for a policy that drives none
    return start, course_of(settings), ranges


def train_robust(
    settings: RobustSettings,
    out: Path,
    *,
    resume: bool = False,
    processes: int | None = None,
    on_generation: Callable[[Generation], None] = lambda _: None,
) -> RobustResult:
    """Train a course-relative circuit and leave the run in the folder ``out``.

    ``processes`` defaults to one for each core; it changes the speed, never the result. A run that is
    interrupted, however it dies, goes on after its last generation and ends in the same files. Raises
    UsageError, ConfigError or FileError, WorkerDied if one of its processes was killed, KeyboardInterrupt.
    """
    start, course, ranges = start_of(settings)
    courses = (course.name, *(["random"] if settings.random_courses else []))
    search = RobustSearch(
        policy_box(start),
        seed=settings.seed,
        rollouts=settings.rollouts,
        worst=settings.worst,
        schedule=REFINING if settings.refine else TRAINING,
    )
    curve: list[tuple[float, float]] = []
    with open_run(out, Record[RobustSettings].of(settings, start, course), resume) as folder:
        if saved := folder.read_state(_STATE):
            search.restore(saved["search"])
            curve = [(best, sigma) for best, sigma in saved["curve"]]

        def policy() -> Policy:
            provenance = folder.record.provenance(search.number, cost=curve[-1][0])
            return replace(start.with_parameters(search.winner), courses=courses, provenance=provenance)

        def save() -> None:
            folder.write_state(_STATE, {"search": search.state(), "curve": curve})
            folder.write("policy.yaml", policy())
            rows = [f"{number},{best!r},{sigma!r}" for number, (best, sigma) in enumerate(curve, 1)]
            folder.write("curve.csv", "\n".join(["generation,cost,spread", *rows, ""]))

        count = min(processes or available_processes(), search.population)
        if search.number == settings.iterations:
            save()  # a run may have died between two files
            count = 1
        with local_workers(count) as workers:
            make = made_in_each_process(partial(_drive, settings, start, course, ranges))
            while search.number < settings.iterations:
                last = search.advance(partial(_drive_parts, workers, count, make))
                curve.append((last.best, last.sigma))
                save()
                on_generation(last)
        best, sigma = curve[-1]
        last = Generation(search.number, search.winner, sigma, best)
        return RobustResult(policy(), folder.policy_path, last)
