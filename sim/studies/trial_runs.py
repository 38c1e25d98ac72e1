"""What ``rover-ncp eval --trials`` does: drive random trials one way or another, and say how they ended."""

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, NamedTuple

import numpy as np
from rich.progress import Progress

from rover_ncp.circuit.policy import Policy
from rover_ncp.circuit.policy_file import load_policy
from rover_ncp.core.console import Output
from rover_ncp.core.course import Course, load_course
from rover_ncp.core.errors import UsageError
from sim.studies.evaluate import Evaluation, evaluate, tally, unseen_courses
from sim.studies.laws import LAWS
from sim.studies.spread import drive_all
from sim.studies.stack import Stack
from sim.world.randomization import load_randomization

__all__ = ["TrialOptions", "run_trials"]


class TrialOptions(NamedTuple):
    """What was asked for."""

    policy: str
    courses: tuple[str, ...]
    trials: int
    seed: int
    randomize: str
    random_courses: int
    stack: bool
    processes: int | None


def run_trials(output: Output, options: TrialOptions) -> int:
    """Drive trials, report, and return the exit code: 1 if a single one was driven and did not park."""
    ranges, seed = load_randomization(options.randomize), options.seed
    if options.random_courses:
        courses: Sequence[Course] = unseen_courses(seed, options.random_courses)
    else:
        courses = [load_course(name) for name in options.courses]
    more: dict[str, Any] = {}
    if options.stack:
        stack = Stack(_circuit(options.policy), tuple(courses), ranges, seed)
        found, more = _through_stack(output, stack, options)
    else:
        driver = options.policy if options.policy in LAWS else load_policy(options.policy)
        found = evaluate(driver, courses, ranges, trials=options.trials, seed=seed)
    fields = found.fields() | {
        "randomize": options.randomize,
        "seed": seed,
        "random_courses": options.random_courses,
        "course": ",".join(options.courses),
    }
    output.result(fields | more, "\n".join(_words(found, more)))
    return 1 if options.trials == 1 and found.success_rate < 1 else 0


def _circuit(policy: str) -> Policy:
    if policy in LAWS:
        raise UsageError(f"{policy}: the classical laws drive in plain simulation alone")
    return load_policy(policy)


def _through_stack(output: Output, stack: Stack, options: TrialOptions) -> tuple[Evaluation, dict[str, Any]]:
    began = time.monotonic()
    with _progress(output, options.trials) as done:
        driven = drive_all(stack, options.trials, options.processes, done)
    wall_s = time.monotonic() - began
    found = tally(
        np.array([trial.error_m for trial in driven]),
        np.array([trial.error_rad for trial in driven]),
        [trial.reason for trial in driven],
    )
    driven_s = sum(stack.course(number).horizon_s for number in range(options.trials))
    return found, {
        "bytes_to_base": sum(trial.bytes_to_base for trial in driven),
        "bytes_from_base": sum(trial.bytes_from_base for trial in driven),
        "overruns": sum(trial.overruns for trial in driven),
        "wall_s": wall_s,
        "times_real_time": driven_s / wall_s,
    }


@contextmanager
def _progress(output: Output, total: int) -> Iterator[Callable[[], None]]:
    with Progress(console=output.console, transient=True, disable=not output.console.is_terminal) as progress:
        task = progress.add_task("trials", total=total)
        yield lambda: progress.advance(task)


def _words(found: Evaluation, more: dict[str, Any]) -> Iterator[str]:
    low, high = found.success_ci95
    yield f"{found.success_rate:.1%} of {found.trials} trials parked (95 % interval {low:.1%} to {high:.1%})"
    for name, spread, unit in (
        ("distance to the goal", found.error_m, "mm"),
        ("angle to its heading", found.error_rad, "mrad"),
    ):
        p50, p95, most = (1000 * error for error in spread)
        yield f"{name}: median {p50:.0f}, 95 % below {p95:.0f}, at most {most:.0f} {unit}"
    for reason, count in found.failures.items():
        yield f"{count} of those that did not: {reason}"
    if more:
        yield (
            f"{more['bytes_to_base']} bytes to the bases, {more['bytes_from_base']} from them; "
            f"{more['times_real_time']:.0f} times as fast as in reality"
        )
