"""The Python API of the simulator: train, evaluate, explain. ``rover_ncp.api`` has policies and recordings.

    from sim import api

    result = api.train("runs/mine", agents=4, iterations=2000)
    print(api.evaluate(result.policy, trials=100, randomize="full").success_rate)

Each function loads what it needs when it is called. Names of courses, circuits and policies are those of the
command line: a shipped name or a file. Errors are those of ``rover_ncp.core.errors``.
"""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from rover_ncp.circuit.policy import Policy
    from rover_ncp.course.course import Course
    from sim.evaluate.evaluate import Evaluation
    from sim.explain.explain import Explanation
    from sim.learn.agents import Snapshot
    from sim.learn.engine.driver import Driver
    from sim.learn.engine.rollout import Rollout
    from sim.learn.robust import Generation
    from sim.learn.robust_run import RobustResult
    from sim.learn.train import TrainResult

__all__ = ["evaluate", "explain", "explain_task", "rollout", "train", "train_robust", "train_task"]


def train(
    out: str | Path,
    *,
    resume: bool = False,
    processes: int | None = None,
    on_progress: "Callable[[Snapshot], None]" = lambda snapshot: None,
    **settings: Any,
) -> "TrainResult":
    """Train circuits on one course, as ``rover-ncp train``, and leave the run in the folder ``out``.

    ``settings`` are those of `sim.learn.record.TrainSettings`: course, circuit, seed, agents, iterations and
    search. ``on_progress`` gets all agents after every round. Raises ConfigError, FileError and UsageError.
    """
    from rover_ncp.core.config import validated
    from sim.learn.record import TrainSettings
    from sim.learn.train import train as run

    asked = validated(settings, TrainSettings, "train")
    return run(asked, Path(out), resume=resume, processes=processes, on_progress=on_progress)


def train_robust(
    out: str | Path,
    *,
    resume: bool = False,
    processes: int | None = None,
    on_generation: "Callable[[Generation], None]" = lambda generation: None,
    **settings: Any,
) -> "RobustResult":
    """Train on random robots and courses, as ``rover-ncp train --randomize``.

    ``settings`` are those of `sim.learn.record.RobustSettings`: course, circuit, randomize, seed, iterations,
    rollouts, worst (by default all rollouts), random_courses, refine and profile. The command's bytes need
    ``OPENBLAS_NUM_THREADS=1`` in the environment: with more threads the last bits differ. Raises as `train`
    does.
    """
    from rover_ncp.core.config import validated
    from sim.learn.record import RobustSettings
    from sim.learn.robust_run import train_robust as run

    asked = validated(settings, RobustSettings, "train_robust")
    return run(asked, Path(out), resume=resume, processes=processes, on_generation=on_generation)


def train_task(
    out: str | Path,
    *,
    resume: bool = False,
    processes: int | None = None,
    on_generation: "Callable[[Generation], None]" = lambda generation: None,
    **settings: Any,
) -> "RobustResult":
    """Train on a Gymnasium environment, as ``rover-ncp train --task``.

    ``settings`` are those of `sim.learn.record.TaskSettings`: task (the environment's id), circuit (a policy
    file), seed, iterations and rollouts. Raises as `train` does.
    """
    from rover_ncp.core.config import validated
    from sim.learn.environment_run import train_task as run
    from sim.learn.record import TaskSettings

    asked = validated(settings, TaskSettings, "train_task")
    return run(asked, Path(out), resume=resume, processes=processes, on_generation=on_generation)


def evaluate(
    policy: "Policy | str | Path | Callable[[NDArray[np.float64]], Any]",
    course: "Course | str | Path | Sequence[Course | str | Path]" = "parking",
    *,
    trials: int,
    randomize: str | Path = "none",
    seed: int = 0,
    stack: bool = False,
) -> "Evaluation":
    """Drive random trials, trial i on course i modulo their number, and return how they ended.

    With the default of ``randomize`` the trials of a course differ only if the policy draws random numbers.

    ``policy`` is a name as ``rover-ncp eval`` takes it, or a function from an observation to v and omega. Its
    attribute ``signals`` names what it observes, by default x, y, theta and start. Its method ``reset``, if
    there is one, begins each trial. With ``stack`` the trials go through firmware, bridge and driver.
    """
    from sim.evaluate.evaluate import drive_trials, tally
    from sim.stack.trials import Stack, drive_all
    from sim.world.described import ranges_for

    many = [course] if isinstance(course, str | Path) or not isinstance(course, Sequence) else course
    ranges, courses, driver = ranges_for(randomize, None), [_course(each) for each in many], _driver(policy)
    if stack:
        # A function may be unknown to other processes.
        return tally(drive_all(Stack(driver, tuple(courses), ranges, seed), trials, 1))
    return tally(drive_trials(driver, courses, ranges, trials=trials, seed=seed))


def rollout(policy: "Policy | str | Path", course: "Course | str | Path" = "parking") -> "Rollout":
    """Drive a course once and return the trace of poses, commands and potentials; a law has none."""
    from sim.learn.engine.rollout import rollout as run

    driver = _driver(policy)
    return run(driver.signals, _course(course), runner=driver.runner())


def explain(source: str | Path, course: str | None = None) -> "Explanation":
    """Explain a policy or a recording, as ``rover-ncp explain``; its ``result()`` has plain values."""
    from sim.explain.explain import explain as run

    return run(str(source), course)


def explain_task(source: "str | Path | None", task: str) -> "Explanation":
    """Explain a policy on a benchmark of the paper or a Gymnasium environment, as ``explain --task``."""
    from sim.explain.task import explain_task as run

    return run(None if source is None else str(source), task)


def _driver(given: "Policy | str | Path | Callable[[NDArray[np.float64]], Any]") -> "Driver":
    from rover_ncp.circuit.policy import Policy
    from sim.learn.engine.driver import circuit_driver, function_driver, load_driver

    if isinstance(given, str | Path):
        return load_driver(str(given))
    return circuit_driver(given) if isinstance(given, Policy) else function_driver(given)


def _course(given: "Course | str | Path") -> "Course":
    from rover_ncp.course.course import load_course

    return load_course(given) if isinstance(given, str | Path) else given
