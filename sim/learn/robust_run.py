"""A robust training from settings to files: what ``rover-ncp train --randomize`` does.

settings.yaml      the record, written first
search.json        the search between two generations, and the curve so far: all that resuming needs
policy.yaml        the winner, with the command that makes it again
curve.csv          generation, best cost in it, spread of the search
"""

import json
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rover_ncp.circuit.policy import Policy, course_policy
from rover_ncp.circuit.policy_file import load_start, save_policy
from rover_ncp.circuit.rover_interface import RoverInterface
from rover_ncp.core.errors import FileError, RoverNcpError, UsageError
from rover_ncp.core.files import read_text, write_atomic
from rover_ncp.course.course import Course
from rover_ncp.course.reference import plan_reference
from sim.learn.evaluator import Evaluator
from sim.learn.record import Record, RobustSettings, TaskSettings, course_of
from sim.learn.robust import (
    Drive,
    Generation,
    RobustSearch,
    drive_trials,
    policy_box,
    training_courses,
)
from sim.learn.run_folder import open_folder, require_run
from sim.learn.train import find_workers
from sim.learn.workers import Workers, available_processes, made_in_each_process
from sim.world.described import ranges_for
from sim.world.randomization import Randomization, draw_trials

FloatArray = NDArray[np.float64]

# Checkpoints take at most this share of the time.
_CHECKPOINT_SHARE = 0.02


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
    model, ticks = settings.rover, max(each.ticks for each in courses)
    nothing_yet = draw_trials(ranges, model, settings.seed, count=1, ticks=ticks)
    engine = Evaluator(start, courses, model, nothing_yet, references)
    return drive_trials(engine, ranges, model, settings.seed)


def _drive_parts(workers: Workers, drive: Drive, vectors: FloatArray, *which: Any) -> FloatArray:
    """Drive trials in workers, each of which takes its part of the vectors (k, P)."""
    parts = [part for part in np.array_split(vectors, workers.count) if len(part)]
    futures = [workers.submit(drive, part, *which) for part in parts]
    return np.concatenate([future.result() for future in futures])


def start_of(settings: RobustSettings) -> tuple[Policy, Course, Randomization]:
    """Return the untuned policy, the course and the trials' ranges. Raises UsageError or FileError."""
    if settings.worst > settings.rollouts:
        raise UsageError(f"the worst {settings.worst} of {settings.rollouts} rollouts cannot be taken")
    ranges = ranges_for(settings.randomize, Path(settings.profile) if settings.profile else None)
    loaded = load_start(settings.circuit)
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
        policy_box(start), seed=settings.seed, rollouts=settings.rollouts, worst=settings.worst
    )
    courses = (course.name, *(["random"] if settings.random_courses else []))
    with open_folder(out, record, resume) as began:
        run = SearchRun(out, began, replace(start, courses=courses), search)
        return run.finished(make, processes, on_generation)


class SearchRun:
    """A search and its folder. ``start`` is the untuned policy."""

    def __init__(
        self,
        path: Path,
        record: Record[RobustSettings] | Record[TaskSettings],
        start: Policy,
        search: RobustSearch,
    ) -> None:
        self.policy_path = path / "policy.yaml"
        self._saved, self._curve_path = path / "search.json", path / "curve.csv"
        self._record, self._start, self._iterations = record, start, record.settings.iterations
        self.search = search
        self._curve: list[tuple[float, float]] = []
        if self._saved.is_file():
            self._load()

    @property
    def last(self) -> Generation:
        """The newest generation."""
        best, spread = self._curve[-1]
        return Generation(self.search.number, self.search.winner, spread, best)

    def finished(
        self,
        make: Callable[[], Drive],
        processes: int | None,
        on_generation: Callable[[Generation], None],
    ) -> RobustResult:
        """Search to the end with what ``make`` makes in each process."""
        if self.search.number < self._iterations:
            with find_workers(min(processes or available_processes(), self.search.population)) as workers:
                self.advance(partial(_drive_parts, workers, made_in_each_process(make)), on_generation)
        return RobustResult(self.save(), self.policy_path, self.last)

    def advance(self, drive: Drive, on_generation: Callable[[Generation], None]) -> None:
        """Search to the end; save the state if the run ends early."""
        saved_s = save_cost_s = 0.0
        # What an interrupt in the middle of a generation leaves is no state to go on from.
        state = self.search.state()
        try:
            while self.search.number < self._iterations:
                last = self.search.advance(drive)
                self._curve.append((last.best, last.spread))
                state = self.search.state()
                on_generation(last)
                now = time.monotonic()
                if now - saved_s > save_cost_s / _CHECKPOINT_SHARE:
                    self.save()
                    saved_s = time.monotonic()
                    save_cost_s = saved_s - now
        except (KeyboardInterrupt, RoverNcpError):
            self.search.restore(state)
            del self._curve[self.search.number :]
            if self._curve:
                self.save()
            raise

    def save(self) -> Policy:
        """Write what resuming needs, then the winner and the curve. Raises FileError."""
        require_run(self.policy_path.parent)
        state = {"format": 1, "search": self.search.state(), "curve": self._curve}
        write_atomic(self._saved, json.dumps(state, allow_nan=False) + "\n")
        last = self.last
        policy = replace(
            self._start.with_parameters(last.winner),
            provenance=self._record.provenance(last.number, cost=last.best),
        )
        save_policy(self.policy_path, policy)
        rows = [f"{number},{best!r},{spread!r}" for number, (best, spread) in enumerate(self._curve, 1)]
        write_atomic(self._curve_path, "\n".join(["generation,cost,spread", *rows, ""]))
        return policy

    def _load(self) -> None:
        try:
            data = json.loads(read_text(self._saved))
            self.search.restore(data["search"])
            self._curve = [(float(best), float(spread)) for best, spread in data["curve"]]
            if data["format"] != 1 or len(self._curve) != self.search.number:
                raise ValueError("it does not fit together")
        except (ValueError, KeyError, TypeError, RecursionError) as error:
            raise FileError(f"{self._saved}: damaged; delete it to begin again") from error
