"""Training on random trials, generation by generation."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rover_ncp.circuit.policy import Policy, course_policy
from rover_ncp.circuit.policy_file import load_start
from rover_ncp.circuit.rover_interface import RoverInterface
from rover_ncp.core.errors import UsageError
from rover_ncp.course.course import Course
from rover_ncp.course.reference import plan_reference
from sim.learn.engine.evaluator import Evaluator
from sim.learn.record import Record, RobustSettings, course_of
from sim.learn.robust import (
    REFINING,
    TRAINING,
    Drive,
    Generation,
    RobustSearch,
    drive_trials,
    policy_box,
    training_courses,
)
from sim.learn.run_folder import RunFolder, checkpoints, open_run
from sim.learn.workers import Workers, answer, available_processes, local_workers, made_in_each_process
from sim.world.randomization import Randomization

FloatArray = NDArray[np.float64]

_STATE = "search.json"
"""File of a search by generations."""


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


def _drive_parts(workers: Workers, drive: Drive, vectors: FloatArray, *which: Any) -> FloatArray:
    """Drive trials in workers, each of which takes its part of the vectors (k, P)."""
    parts = [part for part in np.array_split(vectors, workers.count) if len(part)]
    futures = [workers.submit(drive, part, *which) for part in parts]
    answers = zip(futures, parts, strict=True)
    return np.concatenate([answer(future, np.ndarray, len(part)) for future, part in answers])


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
    interrupted, however it dies, can be resumed and ends in the same files. Raises UsageError, ConfigError
    or FileError, WorkerDied if one of its processes was killed, KeyboardInterrupt.
    """
    start, course, ranges = start_of(settings)
    record = Record[RobustSettings].of(settings, start, course)
    make = partial(_drive, settings, start, course, ranges)
    search = RobustSearch(
        policy_box(start),
        seed=settings.seed,
        rollouts=settings.rollouts,
        worst=settings.worst,
        schedule=REFINING if settings.refine else TRAINING,
    )
    courses = (course.name, *(["random"] if settings.random_courses else []))
    with open_run(out, record, resume) as folder:
        run = SearchRun(folder, replace(start, courses=courses), search)
        return run.finish(make, processes, on_generation)


class SearchRun:
    """A search, which begins where its folder says, and its files. ``start`` is the untuned policy."""

    def __init__(
        self,
        folder: RunFolder[RobustSettings],
        start: Policy,
        search: RobustSearch,
    ) -> None:
        self._folder, self._start, self.search = folder, start, search
        self._curve: list[tuple[float, float]] = []
        if saved := folder.read_state(_STATE):
            self.search.restore(saved["search"])
            self._curve = [(best, sigma) for best, sigma in saved["curve"]]
        # An interrupt in the middle of a generation leaves a search that cannot be saved.
        self._state = search.state()

    @property
    def last(self) -> Generation:
        """The newest generation."""
        best, sigma = self._curve[-1]
        return Generation(len(self._curve), self.search.winner, sigma, best)

    def finish(
        self,
        make: Callable[[], Drive],
        processes: int | None,
        on_generation: Callable[[Generation], None],
    ) -> RobustResult:
        """Search to the end with the function that ``make`` makes in each process."""
        iterations = self._folder.record.settings.iterations
        if self.search.number < iterations:
            count = min(processes or available_processes(), self.search.population)
            with checkpoints(self.save) as checkpoint, local_workers(count) as workers:
                drive = partial(_drive_parts, workers, made_in_each_process(make))
                while self.search.number < iterations:
                    last = self.search.advance(drive)
                    self._curve.append((last.best, last.sigma))
                    self._state = self.search.state()
                    on_generation(last)
                    checkpoint()
        self.save()
        return RobustResult(self.policy(), self._folder.policy_path, self.last)

    def save(self) -> None:
        """Write what resuming needs, then the winner and the curve, if there is a generation."""
        self.search.restore(self._state)
        del self._curve[self.search.number :]
        if not self._curve:
            return
        write = self._folder.write
        self._folder.write_state(_STATE, {"search": self._state, "curve": self._curve})
        write("policy.yaml", self.policy())
        rows = [f"{number},{best!r},{sigma!r}" for number, (best, sigma) in enumerate(self._curve, 1)]
        write("curve.csv", "\n".join(["generation,cost,spread", *rows, ""]))

    def policy(self) -> Policy:
        """Return the winner with its provenance."""
        last = self.last
        provenance = self._folder.record.provenance(last.iterations, cost=last.best)
        return replace(self._start.with_parameters(last.winner), provenance=provenance)
