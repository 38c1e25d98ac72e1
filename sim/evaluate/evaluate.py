"""Many trials of one policy, and their outcomes. The true pose is judged."""

from collections import Counter
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rover_ncp.core.errors import UsageError
from rover_ncp.course.course import Course, Failure
from sim.evaluate.driver import Driver
from sim.learn.evaluator import Outcomes
from sim.world.described import default_rover
from sim.world.random_course import random_course
from sim.world.randomization import Randomization, draw_trials
from sim.world.rover import RoverModel

_BATCH = 500
"""Trials at a time, so that drawn noise takes some 10 MB whatever is asked for."""


class Spread(NamedTuple):
    """Median, 95th percentile and largest of an error."""

    p50: float
    p95: float
    max: float

    @classmethod
    def of(cls, errors: NDArray[np.float64]) -> "Spread":
        """Return the spread of errors (n,)."""
        p50, p95 = np.percentile(errors, [50, 95]).tolist()
        return cls(p50, p95, float(errors.max()))


class Evaluation(NamedTuple):
    """How trials ended; errors of all of them, parked or not, in m and rad."""

    trials: int
    success_rate: float
    success_ci95: tuple[float, float]
    """Wilson's interval."""
    error_m: Spread
    error_rad: Spread
    failures: dict[str, int]
    """First reason, in the order of ``Course.judge``: how many."""


def evaluate(
    driver: Driver,
    courses: Sequence[Course],
    ranges: Randomization,
    *,
    trials: int,
    seed: int,
    model: RoverModel | None = None,
) -> Evaluation:
    """Drive ``trials`` trials of a seed, trial i on course i modulo their number. Raises ConfigError."""
    if trials < 1:
        raise UsageError(f"at least one trial must be driven, got {trials}")
    model = model or default_rover()
    ticks = max(course.ticks for course in courses)
    engine, found = None, []
    for first in range(0, trials, _BATCH):
        count = min(_BATCH, trials - first)
        drawn = draw_trials(ranges, model, seed, count=count, ticks=ticks, first=first)
        if engine is None:
            engine = driver.evaluator(courses, model, drawn)
        else:
            engine.change_trials(drawn, first)
        found.append(engine.outcomes(driver.vector))
    rules = [courses[i % len(courses)].parked for i in range(trials)]
    limits = np.array([[rule.position_m, rule.heading_rad] for rule in rules])
    return summarize(
        Outcomes(*(np.concatenate(column, axis=1) for column in zip(*found, strict=True))), limits
    )


def summarize(found: Outcomes, limits: NDArray[np.float64]) -> Evaluation:
    """Return how the trials of one candidate ended; ``limits`` (trials, 2) are the courses' m and rad."""
    parked = found.parked[0]
    reasons = np.select(
        [
            parked,
            found.touched[0],
            ~(found.error_m[0] <= limits[:, 0]),
            ~(found.error_rad[0] <= limits[:, 1]),
        ],
        [Failure.NONE.value, Failure.TOUCHED.value, Failure.FAR.value, Failure.TURNED.value],
        Failure.MOVING.value,
    )
    return tally(found.error_m[0], found.error_rad[0], reasons.tolist())


def tally(error_m: NDArray[np.float64], error_rad: NDArray[np.float64], causes: Sequence[str]) -> Evaluation:
    """Sum up trials from their errors (n,) and why each did not park, "" if it did."""
    count, successes = len(causes), causes.count("")
    failures = Counter(why for why in causes if why)
    return Evaluation(
        trials=count,
        success_rate=successes / count,
        success_ci95=_wilson(successes, count),
        error_m=Spread.of(error_m),
        error_rad=Spread.of(error_rad),
        failures=dict(failures.most_common()),
    )


def _wilson(successes: int, count: int) -> tuple[float, float]:
    from scipy.stats import binomtest

    low, high = binomtest(successes, count).proportion_ci(method="wilson")
    return float(low), float(high)


def unseen_courses(seed: int, count: int) -> list[Course]:
    """Return random courses for an evaluation; a policy gets their checkpoints, not the drive behind."""
    return [random_course(seed, number)[0] for number in range(count)]
