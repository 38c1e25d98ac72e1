"""Many trials of one policy, and their outcomes. The true pose is judged."""

from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, Field

from rover_ncp.circuit.policy import Policy
from rover_ncp.circuit.rover_interface import RoverInterface
from rover_ncp.core.errors import UsageError
from rover_ncp.core.files import DEFAULT_ROBOT
from rover_ncp.course.course import Course, load_course
from rover_ncp.course.reference import plan_reference
from rover_ncp.course.scoring import Failure
from rover_ncp.course.slowdown import rounded_up, slowed
from rover_ncp.robot.description import RobotDescription, load_description
from sim.learn.evaluator import Evaluator
from sim.learn.policies import AnyPolicy, any_policy
from sim.learn.rollout import rollout
from sim.world.bodies import Body
from sim.world.described import default_rover, ranges_for
from sim.world.random_course import random_course
from sim.world.randomization import Randomization, Trials, draw_trials
from sim.world.rover import RoverModel

if TYPE_CHECKING:
    from sim.stack.docking import Docked
    from sim.stack.trials import Driven

_BATCH = 500
"""Trials at a time, so that drawn noise takes some 10 MB whatever is asked for."""
_FEW = 3
"""So few trials are driven one by one, with the same bits: this needs no native library."""
_SHOWN = 5
"""Largest number of lines about scaled courses; random courses may be many."""


class Spread(BaseModel):
    """Quantiles of an error."""

    p50: float = Field(description="median")
    p95: float = Field(description="95th percentile")
    max: float = Field(description="largest")

    @classmethod
    def of(cls, errors: NDArray[np.float64]) -> "Spread":
        """Return the spread of errors (n,)."""
        p50, p95 = np.percentile(errors, [50, 95]).tolist()
        return cls(p50=p50, p95=p95, max=float(errors.max()))


class Ended(NamedTuple):
    """End of a trial in plain simulation: errors in m and rad, and why it did not park ("" if it did)."""

    error_m: float
    error_rad: float
    reason: str
    total: float
    """The return."""


class Evaluation(BaseModel):
    """How trials ended; errors of all of them, parked or not, in m and rad."""

    trials: int = Field(description="how many")
    success_rate: float = Field(description="share of trials that parked")
    success_ci95: tuple[float, float] = Field(description="Wilson's 95 % interval")
    error_m: Spread = Field(description="final position error")
    error_rad: Spread = Field(description="final heading error")
    failures: dict[str, int] = Field(description="by the first condition that was missed: number of trials")
    mean_return: float | None = Field(description="the paper's, of all trials; null through the stack")


def trial_count(asked: int | None, courses: int, ranges: Randomization, varies: bool) -> int:
    """Return the number of trials, by default one for each course. Raises UsageError for an unsuitable one.

    ``varies`` is whether the trials of a course differ.
    """
    count = courses if asked is None else asked
    if count < courses:
        raise UsageError(f"--trials {count}: expected at least one trial for each of the {courses} courses")
    if count > courses and not varies:
        preset = "full" if ranges.body is Body.PYMUNK else "varied"
        problem = f"with the randomization {ranges.name} all trials of a course are the same"
        raise UsageError(f"--trials {count}: {problem}; add --randomize {preset}")
    return count


def evaluate(
    policy: Policy | str | Path | Callable[[NDArray[np.float64]], Any],
    course: Course | str | Path | Sequence[Course | str | Path] = "parking",
    *,
    trials: int,
    randomize: str | Path = "none",
    seed: int = 0,
    stack: bool = False,
) -> Evaluation:
    """Drive random trials, trial i on course i modulo their number, and return how they ended.

    ``policy`` is a name as ``rover-ncp eval`` takes it, or a function from an observation to v and omega. Its
    attribute ``signals`` names what it observes, by default x, y, theta and start. Its method ``reset``, if
    there is one, begins each trial. With the default of ``randomize`` the trials of a course differ only if
    the policy draws random numbers. With ``stack`` the trials go through firmware, bridge and driver.
    Raises UsageError, ConfigError and FileError.
    """
    from sim.stack.trials import Stack, drive_all  # slow to load

    tested = any_policy(policy)
    named = [course] if isinstance(course, str | Path) or not isinstance(course, Sequence) else course
    courses = [load_course(each) if isinstance(each, str | Path) else each for each in named]
    ranges = ranges_for(randomize, None)
    if stack:
        # A function may be unknown to other processes.
        return tally(drive_all(Stack(tested, tuple(courses), ranges, seed).drive, trials, 1))
    return tally(drive_trials(tested, courses, ranges, trials=trials, seed=seed))


def drive_trials(
    policy: AnyPolicy,
    courses: Sequence[Course],
    ranges: Randomization,
    *,
    trials: int,
    seed: int,
    model: RoverModel | None = None,
) -> list[Ended]:
    """Drive ``trials`` trials of a seed, trial i on course i modulo their number. Raises UsageError."""
    if trials < 1:
        raise UsageError(f"at least one trial must be driven, got {trials}")
    model = model or default_rover()
    ticks = max(course.ticks for course in courses)
    if policy.circuit and trials > _FEW:
        drive = _drive_lanes(policy.circuit, courses, model)
    else:
        drive = _drive_runner(policy, courses, model)
    found = list[Ended]()
    for first in range(0, trials, _BATCH):
        count = min(_BATCH, trials - first)
        found += drive(draw_trials(ranges, model, seed, count=count, ticks=ticks, first=first), first)
    return found


def _drive_lanes(
    policy: Policy, courses: Sequence[Course], model: RoverModel
) -> Callable[[Trials, int], list[Ended]]:
    """Return what drives trials, of which the first has a number, in the lanes of an evaluator."""
    engine, vector = Evaluator(policy, courses, model), policy.parameters()

    def drive(trials: Trials, first: int) -> list[Ended]:
        engine.change_trials(trials, first)
        found = engine.outcomes(vector)
        rules = [courses[(first + i) % len(courses)].parked for i in range(trials.size)]
        position, heading = np.array([(rule.position_m, rule.heading_rad) for rule in rules]).T
        reasons = np.select(
            [
                found.parked[0],
                found.touched[0],
                ~(found.error_m[0] <= position),
                ~(found.error_rad[0] <= heading),
            ],
            [Failure.NONE.value, Failure.TOUCHED.value, Failure.FAR.value, Failure.TURNED.value],
            Failure.MOVING.value,
        )
        columns = (
            found.error_m[0].tolist(),
            found.error_rad[0].tolist(),
            reasons.tolist(),
            found.total[0].tolist(),
        )
        return [Ended(*row) for row in zip(*columns, strict=True)]

    return drive


def _drive_runner(
    policy: AnyPolicy, courses: Sequence[Course], model: RoverModel
) -> Callable[[Trials, int], list[Ended]]:
    """Return what drives trials one after the other with a runner; arguments as in `_drive_lanes`."""
    needs_reference = RoverInterface(policy.signals).needs_reference
    references = [plan_reference(course) if needs_reference else None for course in courses]
    runner = policy.runner()

    def ended(trials: Trials, row: int, place: int) -> Ended:
        run = rollout(
            policy.signals,
            courses[place],
            model,
            trials=trials,
            row=row,
            reference=references[place],
            runner=runner,
        )
        return Ended(run.verdict.error_m, run.verdict.error_rad, run.verdict.failure, run.total)

    return lambda trials, first: [
        ended(trials, row, (first + row) % len(courses)) for row in range(trials.size)
    ]


def tally(ended: "Sequence[Ended | Driven | Docked]") -> Evaluation:
    """Sum up trials."""
    from scipy.stats import binomtest  # slow to load

    count, failures = len(ended), Counter(str(trial.reason) for trial in ended if trial.reason)
    successes, returns = count - failures.total(), [one.total for one in ended if isinstance(one, Ended)]
    low, high = binomtest(successes, count).proportion_ci(method="wilson")
    return Evaluation(
        trials=count,
        success_rate=successes / count,
        success_ci95=(float(low), float(high)),
        error_m=Spread.of(np.array([trial.error_m for trial in ended])),
        error_rad=Spread.of(np.array([trial.error_rad for trial in ended])),
        failures=dict(failures.most_common()),
        mean_return=float(np.mean(returns)) if returns else None,
    )


def load_courses(names: Sequence[str], random_courses: int | None, seed: int) -> list[Course]:
    """Return the named courses, or random ones of a seed in their place."""
    if random_courses:
        return unseen_courses(seed, random_courses)
    return [load_course(name) for name in names]


def unseen_courses(seed: int, count: int) -> list[Course]:
    """Return random courses for an evaluation; a policy gets their checkpoints, not the drive behind."""
    return [random_course(seed, number)[0] for number in range(count)]


def fitted_courses(
    courses: Sequence[Course], robot: RobotDescription | None
) -> tuple[list[Course], list[str]]:
    """Return courses fitted to a robot, if one is named, and a line on each change."""
    fitted, changes = list(courses), list[str]()
    if robot is not None:
        for place, course in enumerate(courses):
            larger, size = _enlarged(course, robot)
            fitted[place], pace = slowed(larger, robot)
            changes += filter(None, (size, pace))
    more = [f"and {len(changes) - _SHOWN} more courses"] if len(changes) > _SHOWN else []
    return fitted, changes[:_SHOWN] + more


def _enlarged(course: Course, robot: RobotDescription) -> tuple[Course, str]:
    """Return a course with obstacles enlarged for a robot, and a line that reports it; "" if nothing changed.

    Speeds stay, so a larger course takes longer.
    """
    usual = load_description(DEFAULT_ROBOT)
    larger = max(_reach(robot) / _reach(usual), robot.width_m / usual.width_m)
    if not course.obstacles or larger <= 1.0:
        return course, ""
    larger = rounded_up(larger)
    return course.scaled(larger, 1.0), (
        f"{course.name} is {larger:g} times as large for {robot.name}, {robot.length_m:g} m by "
        f"{robot.width_m:g} m, and takes {larger:g} times as long"
    )


def _reach(robot: RobotDescription) -> float:
    """Return how far the outline reaches from the centre of rotation, before or behind it."""
    return max(robot.front_m, robot.rear_m)
