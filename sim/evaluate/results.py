"""The result of the command ``eval``, and its words."""

import math
from collections import Counter
from collections.abc import Iterator, Sequence

import numpy as np
from pydantic import BaseModel, Field

from rover_ncp.robot.description import load_description
from sim.evaluate.evaluate import Ended, Evaluation, fitted_courses, load_courses, tally
from sim.evaluate.options import EvalOptions, Sensors, driver_sensors
from sim.evaluate.trial_runs import drive_courses, drive_dockings, drive_stack
from sim.stack.docking import Docked
from sim.stack.estimates import EstimateSummary, summary, words
from sim.stack.trials import Driven
from sim.world.described import ranges_for

FINE_M, FINE_RAD = 0.01, math.radians(1.0)
DOCKED = "docked"
"""A driver's verdict."""


class StackDrive(BaseModel):
    """One trial through the stack."""

    trial: int = Field(description="its number, from 0: with the root seed it gives the same robot again")
    parked: bool = Field(
        description="whether the rover parked, or docked, by its true pose; no if a safety rule stopped it"
    )
    reason: str = Field(
        description="empty for a success; else the condition that the true pose missed, the safety rule "
        "that stopped the drive, or with --to the driver's error"
    )
    error_m: float = Field(description="final position error of the true pose")
    error_rad: float = Field(description="final heading error of the true pose")
    verdict: str | None = Field(description="the driver's; null if a safety rule stopped the drive")
    probability: float | None = Field(
        description="that the rover is within the tolerances, by the driver's estimate"
    )
    squared: float | None = Field(
        description="squared position error of the driver's estimate, normalised by its covariance: inside "
        "its 95 % ellipse up to 5.99; null without an estimate and with --to"
    )


class StackResult(BaseModel):
    """What trials of courses through the stack have beside their ends."""

    overruns: int = Field(description="of all trials")
    wall_s: float = Field(description="how long it took")
    times_real_time: float = Field(description="driven time over computing time")
    estimate: EstimateSummary = Field(description="of the driver, against the truth")


class DockingResult(BaseModel):
    """What trials of docking have beside their ends."""

    place: str = Field(description="its name")
    verdicts: dict[str, int] = Field(
        description="number of trials by the driver's verdict: docked, not docked; stopped by a safety rule"
    )
    falsely_docked: int = Field(
        description="trials with the verdict docked whose true pose is outside the tolerances"
    )
    within_1_cm_1_degree: int = Field(description="successes whose true pose is so near to the place")
    first_try: int = Field(description="successes of the first try")
    drive_s: float = Field(description="median time of a drive, in simulated time")


class EvalResult(Evaluation):
    """Result of trials: of a course in plain simulation or through the stack, or of docking at a place."""

    randomize: str = Field(description="the name or file of the randomization")
    model: str | None = Field(description="the robot's description, if one was named")
    scaled: list[str] = Field(description="lines on the courses that were changed for the robot")
    body: str = Field(description="the simulator's")
    seed: int = Field(description="root seed")
    random_courses: int = Field(description="how many")
    course: str = Field(description="several are joined by commas; with --to empty")
    stack: StackResult | None = Field(description="with --stack, without --to; else null")
    docking: DockingResult | None = Field(description="with --to; else null")
    drives: list[StackDrive] = Field(description="with --stack each trial; else empty")


def measure(options: EvalOptions) -> EvalResult:
    """Drive trials and return how they ended. Raises RoverNcpError."""
    robot = None if options.model is None else load_description(options.model)
    ranges = ranges_for(options.randomization, options.profile, options.body, robot)
    stack, docking, scaled = None, None, list[str]()
    ended: Sequence[Ended | Driven | Docked]
    if options.to is not None:
        gyro, _ = driver_sensors(options.sensors or (None if robot else Sensors.GYRO), robot)
        place, dockings = drive_dockings(options, options.to, robot, ranges, gyro)
        ended, docking = dockings, docking_result(place, dockings)
    else:
        courses, scaled = fitted_courses(
            load_courses(options.courses, options.random_courses, options.seed), robot
        )
        if options.stack:
            sensors = driver_sensors(options.sensors, robot)
            drives, driven_s, wall_s = drive_stack(options, courses, robot, ranges, sensors)
            ended, stack = drives, stack_result(drives, driven_s, wall_s)
        else:
            ended = drive_courses(options, courses, robot, ranges)
    return EvalResult(
        **vars(tally(ended)),
        randomize=options.randomization or ranges.name,
        model=options.model,
        scaled=scaled,
        body=options.body.value,
        seed=options.seed,
        random_courses=options.random_courses or 0,
        course="" if options.to else ",".join(options.courses),
        stack=stack,
        docking=docking,
        drives=list(drives_of(ended)),
    )


def stack_result(driven: Sequence[Driven], driven_s: float, wall_s: float) -> StackResult:
    """Return what trials of courses show that took ``wall_s`` for ``driven_s`` of driving."""
    return StackResult(
        overruns=sum(trial.overruns for trial in driven),
        wall_s=wall_s,
        times_real_time=driven_s / wall_s,
        estimate=summary([trial.belief for trial in driven], [trial.parked for trial in driven]),
    )


def docking_result(place: str, driven: Sequence[Docked]) -> DockingResult:
    """Return what trials of docking at a place show."""
    good = [trial for trial in driven if not trial.reason]
    return DockingResult(
        place=place,
        verdicts=dict(Counter(_verdict(trial) or "stopped" for trial in driven).most_common()),
        falsely_docked=sum(_verdict(trial) == DOCKED and not trial.docked for trial in driven),
        within_1_cm_1_degree=sum(trial.error_m <= FINE_M and trial.error_rad <= FINE_RAD for trial in good),
        first_try=sum(trial.result.num_retries == 0 for trial in good),
        drive_s=float(np.median([trial.seconds for trial in driven])),
    )


def drives_of(ended: Sequence[Ended | Driven | Docked]) -> Iterator[StackDrive]:
    """Yield the trials that went through the stack."""
    for number, trial in enumerate(ended):
        if not isinstance(trial, Ended):
            yield stack_drive(number, trial)


def stack_drive(number: int, trial: Driven | Docked) -> StackDrive:
    """Return the end of a trial through the stack."""
    if isinstance(trial, Driven):
        belief = trial.belief
        parked, probability = trial.parked, belief.probability
        squared = belief.squared if math.isfinite(belief.squared) else None
    else:
        parked, probability, squared = trial.docked and not trial.stop, trial.result.probability, None
    return StackDrive(
        trial=number,
        parked=parked,
        reason=trial.reason,
        error_m=trial.error_m,
        error_rad=trial.error_rad,
        verdict=_verdict(trial),
        probability=probability,
        squared=squared,
    )


def _verdict(trial: Driven | Docked) -> str | None:
    """Return the driver's verdict; None if a safety rule stopped the drive."""
    if isinstance(trial, Driven):
        return trial.belief.verdict
    return None if trial.stop else DOCKED if trial.result.success else "not docked"


def result_words(found: EvalResult) -> Iterator[str]:
    """Yield lines about a result."""
    yield from found.scaled
    end = "" if found.mean_return is None else f"; mean return {found.mean_return:.4f}"
    if found.trials == 1:
        reason = "".join(f"not parked: {reason}" for reason in found.failures)
        yield f"{reason or 'parked'}{end.replace('mean ', '')}"
    else:
        low, high = found.success_ci95
        share = f"{found.success_rate:.1%} of {found.trials} trials parked"
        yield f"{share} (95 % interval {low:.1%} to {high:.1%}){end}"
    for name, spread, unit in (
        ("final position error", found.error_m, "mm"),
        ("final heading error", found.error_rad, "mrad"),
    ):
        p50, p95, largest = (1000 * error for error in (spread.p50, spread.p95, spread.max))
        several = f"median {p50:.0f}, 95th percentile {p95:.0f}, largest {largest:.0f} {unit}"
        yield f"{name}: {several if found.trials > 1 else f'{largest:.0f} {unit}'}"
    if found.trials > 1:
        for reason, count in found.failures.items():
            yield f"not parked, {reason}: {count}"
    if found.stack:
        yield from words(found.stack.estimate)
        yield f"{found.stack.times_real_time:.0f} times real time"
    if docking := found.docking:
        yield (
            f"parked within the place's tolerances; declared docked: {docking.verdicts.get(DOCKED, 0)}, "
            f"falsely: {docking.falsely_docked}; at the first try: {docking.first_try}; within 1 cm and 1°: "
            f"{docking.within_1_cm_1_degree}; median time {docking.drive_s:.0f} s"
        )
