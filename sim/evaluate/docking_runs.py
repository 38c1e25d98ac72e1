"""Random trials of docking through the stack, summed up."""

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
from pydantic import Field

from deploy.place.outcome import DockError
from sim.evaluate.evaluate import Ended, Evaluation, tally
from sim.evaluate.results import StackDrive
from sim.evaluate.trial_runs import progress, result_words
from sim.stack.docking import Docked, DockTrials
from sim.stack.trials import drive_all

FINE_M, FINE_RAD = 0.01, math.radians(1.0)


class DockingResult(Evaluation):
    """Result of random trials of docking; success is docked by the proof and by the true pose."""

    place: str = Field(description="its name")
    randomize: str = Field(description="the name or file of the randomization")
    model: str | None = Field(description="the robot's description, if one was named")
    body: str = Field(description="the simulator's")
    seed: int = Field(description="root seed")
    said_docked: int = Field(description="trials that the driver declared docked")
    falsely_docked: int = Field(description="those of them whose true pose is outside the tolerances")
    within_1_cm_1_degree: int = Field(description="successes whose true pose is so near to the place")
    first_try: int = Field(description="successes of the first try")
    drive_s: float = Field(description="median time of a drive, in simulated time")
    drives: list[StackDrive] = Field(description="each trial")


def evaluate_docking(trials: DockTrials, count: int, processes: int | None, **about: Any) -> DockingResult:
    """Drive trials, and return how they ended, ``about`` with it. Raises WorkerDied."""
    with progress(count) as done:
        driven = drive_all(trials, count, processes, done)
    ended = [Ended(_off_m(trial), abs(trial.off.yaw_rad), _reason(trial)) for trial in driven]
    good = [trial for trial in driven if not _reason(trial)]
    fine = [trial for trial in good if _off_m(trial) <= FINE_M and abs(trial.off.yaw_rad) <= FINE_RAD]
    return DockingResult(
        **vars(tally(ended)),
        **about,
        place=trials.place.name,
        seed=trials.seed,
        said_docked=sum(trial.result.success for trial in driven),
        falsely_docked=sum(trial.result.success and not trial.docked for trial in driven),
        within_1_cm_1_degree=len(fine),
        first_try=sum(trial.result.num_retries == 0 for trial in good),
        drive_s=float(np.median([trial.seconds for trial in driven])),
        drives=[_drive(number, trial) for number, trial in enumerate(driven)],
    )


def _drive(number: int, trial: Docked) -> StackDrive:
    return StackDrive(
        trial=number,
        parked=not _reason(trial),
        reason=_reason(trial),
        error_m=_off_m(trial),
        error_rad=abs(trial.off.yaw_rad),
        verdict=None if trial.stop else "docked" if trial.result.success else "not docked",
        probability=trial.result.probability,
    )


def _off_m(trial: Docked) -> float:
    return math.hypot(trial.off.longitudinal_m, trial.off.lateral_m)


def _reason(trial: Docked) -> str:
    if trial.stop:
        return f"stopped by {trial.stop}"
    if trial.result.success:
        return "" if trial.docked else "falsely docked"
    return DockError(trial.result.error_code).name


def docking_words(found: DockingResult) -> Iterator[str]:
    """Yield lines about trials of docking."""
    yield from result_words(found, None)
    yield (
        f"parked within the place's tolerances; declared docked: {found.said_docked}, falsely: "
        f"{found.falsely_docked}; at the first try: {found.first_try}; within 1 cm and 1°: "
        f"{found.within_1_cm_1_degree}; median time {found.drive_s:.0f} s"
    )
