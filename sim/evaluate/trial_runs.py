"""The trials of the command ``eval``: in plain simulation, through the stack, and of docking."""

import itertools
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

from deploy.place.place import load_place
from rover_ncp.circuit.policy_file import load_policy
from rover_ncp.core.console import progress
from rover_ncp.course.course import Course
from rover_ncp.robot.description import RobotDescription
from sim.evaluate.evaluate import Ended, drive_trials, trial_count
from sim.evaluate.options import EvalOptions, Scene
from sim.learn.policies import any_policy
from sim.stack.docking import Docked, DockTrials
from sim.stack.tag_camera import TagLocaliser
from sim.stack.trials import Driven, Stack, drive_all
from sim.world.described import described_rover
from sim.world.randomization import Randomization


def drive_courses(
    options: EvalOptions, courses: Sequence[Course], robot: RobotDescription | None, ranges: Randomization
) -> list[Ended]:
    """Drive courses in plain simulation. Raises UsageError for an unsuitable number of trials."""
    trials = trial_count(options.trials, len(courses), ranges, ranges.varies)
    model = described_rover(robot) if robot else None
    return drive_trials(
        any_policy(options.policy), courses, ranges, trials=trials, seed=options.seed, model=model
    )


def drive_stack(
    options: EvalOptions,
    courses: Sequence[Course],
    robot: RobotDescription | None,
    ranges: Randomization,
    sensors: tuple[bool, bool],
) -> tuple[list[Driven], float, float]:
    """Drive courses through the stack; return the trials, their time, and the time that this took, in s.

    Raises UsageError as `drive_courses`, and WorkerDied.
    """
    policy = any_policy(options.policy)
    stack = Stack(policy, tuple(courses), ranges, options.seed, *sensors, options.identify, robot)
    count = trial_count(options.trials, len(courses), ranges, stack.varies)
    began = time.monotonic()
    with trial_progress(count) as done:
        driven = drive_all(stack.drive, count, options.processes, done)
    return driven, sum(stack.course(number).horizon_s for number in range(count)), time.monotonic() - began


def drive_dockings(
    options: EvalOptions, name: str, robot: RobotDescription | None, ranges: Randomization, gyro: bool
) -> tuple[str, list[Docked]]:
    """Dock at a place through the stack; return the place's name and the trials. Raises WorkerDied."""
    place, localiser = load_place(name), TagLocaliser
    if options.images:
        from sim.stack.board_scenes import SCENES

        localiser = SCENES[options.scene or Scene.TAGS]
    trials = DockTrials(
        load_policy("course"),
        load_policy(options.policy),
        place,
        ranges,
        options.seed,
        gyro=gyro,
        robot=robot,
        localiser=localiser,
        blind=options.blind,
    )
    count = options.trials or 1
    with trial_progress(count) as done:
        return place.name, drive_all(trials.drive, count, options.processes, done)


@contextmanager
def trial_progress(total: int) -> Iterator[Callable[[], None]]:
    """Show the progress of trials, of which the block reports each."""
    counted = itertools.count(1)
    with progress(total, "trials") as show:
        yield lambda: show(next(counted), "")
