"""``rover-ncp eval --trials``: drive random trials in simulation, stack or live, and report the outcomes."""

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
from rich.progress import Progress

from rover_ncp.core.console import Output
from rover_ncp.core.errors import UsageError
from rover_ncp.core.geometry import distance, wrap_angle
from rover_ncp.robot.description import RobotDescription
from sim.evaluate.commands import EvalOptions, Sensors
from sim.evaluate.courses import fitted_courses
from sim.evaluate.driver import CIRCUIT, load_driver
from sim.evaluate.evaluate import Evaluation, Spread, evaluate, tally
from sim.live.trials import drive_live, trial_folder
from sim.stack.camera import Camera
from sim.stack.estimates import summary, words
from sim.stack.trials import Driven, Stack, drive_all
from sim.world.described import described_rover, ranges_for


def run_trials(options: EvalOptions) -> int:
    """Drive trials, report, and return the exit code: 1 if a single one was driven and did not park."""
    courses, robot, fitted = fitted_courses(options)
    ranges = ranges_for(options.randomization, options.profile, options.body, robot)
    trials, driver = options.trials or options.live or 1, load_driver(options.policy)
    output, more = Output(options.json), dict[str, Any]()
    if options.stack or options.live:
        if options.live and driver.agent != CIRCUIT:
            raise UsageError(f"{options.policy}: --live needs a policy")
        camera = Camera()
        gyro, seen = _sensors(options, robot)
        stack = Stack(
            driver,
            tuple(courses),
            ranges,
            options.seed,
            gyro=gyro,
            camera=camera if seen else None,
            identify=options.identify,
            identify_camera=camera,
            robot=robot,
            knows_family=not options.live,
        )
        run = _live if options.live else _through_stack
        found, more = run(output, stack, options, trials)
    else:
        model = described_rover(robot) if robot else None
        found = evaluate(driver, courses, ranges, trials=trials, seed=options.seed, model=model)
    fields = found._asdict() | {
        "randomize": options.randomization or ranges.name,  #: the name or file of the randomization
        **fitted,
        "body": options.body.value,  #: the simulator's
        "seed": options.seed,  #: root seed
        "random_courses": options.random_courses or 0,  #: how many
        "course": ",".join(options.courses),  #: several are joined by commas
    }
    output.result(fields | more, "\n".join([*fitted["scaled"], *_words(found, more)]))
    return 1 if found.trials == 1 and found.success_rate < 1 else 0


def _sensors(options: EvalOptions, robot: RobotDescription | None) -> tuple[bool, bool]:
    """Return whether the driver has a gyro, and whether it has a camera."""
    if options.sensors is None:
        return robot is not None and robot.gyro is not None, False
    gyro = options.sensors in {Sensors.GYRO, Sensors.BOTH}
    if gyro and robot is not None and robot.arcos is None and robot.gyro is None:
        raise UsageError(f"--sensors {options.sensors}: {robot.name} has no gyro")
    return gyro, options.sensors in {Sensors.CAMERA, Sensors.BOTH}


def _through_stack(
    output: Output, stack: Stack, options: EvalOptions, trials: int
) -> tuple[Evaluation, dict[str, Any]]:
    began = time.monotonic()
    with _progress(output, trials) as done:
        driven = drive_all(stack, trials, options.processes, done)
    wall_s = time.monotonic() - began
    driven_s = sum(stack.course(number).horizon_s for number in range(trials))
    beliefs = [trial.belief for trial in driven if trial.belief is not None]
    fields = _totals(driven) | {"wall_s": wall_s, "times_real_time": driven_s / wall_s}
    return _sum_up(driven), fields | {"estimate": summary(beliefs, [trial.parked for trial in driven])}


def _live(
    output: Output, stack: Stack, options: EvalOptions, trials: int
) -> tuple[Evaluation, dict[str, Any]]:
    """Drive live; with ``stack`` the same trials on the virtual clock, too, to compare where they end."""
    count = options.live or 0
    if count > trials:
        raise UsageError(f"--live {count}: there are only {trials} trials")
    if options.folder.exists() and any(options.folder.iterdir()):
        raise UsageError(f"{options.folder}: is not an empty folder")
    with _progress(output, count) as done:
        driven = drive_live(stack, options, count, done)
    virtual = drive_all(stack, count, options.processes) if options.stack else []
    apart = [_apart(*both) for both in zip(driven, virtual, strict=False)]
    entries = [
        {
            "trial": number,  #: its number
            "course": stack.course(number).name,  #: its name
            **{name: getattr(trial, name) for name in ("parked", "reason", "error_m", "error_rad")},
            "pose": list(trial.pose),  #: the true one at the end: x, y, theta
            "overruns": trial.overruns,
            #: of the trial: course.yaml, driver.yaml, run.mcap, log
            "folder": str(trial_folder(options.folder, number)),
            **(apart[number] if apart else {}),
        }
        for number, trial in enumerate(driven)
    ]
    fields = _totals(driven) | {"live": entries}
    if apart:
        fields |= {
            name: Spread.of(np.array([each[name] for each in apart]))._asdict()
            for name in ("apart_m", "apart_rad")
        }
    return _sum_up(driven), fields


def _apart(live: Driven, virtual: Driven) -> dict[str, float]:
    """Return how far apart two drives of a trial ended."""
    return {
        "apart_m": distance(live.pose, virtual.pose),
        "apart_rad": abs(wrap_angle(live.pose.theta - virtual.pose.theta)),  #: between their headings
    }


def _sum_up(driven: Sequence[Driven]) -> Evaluation:
    errors = np.array([(trial.error_m, trial.error_rad) for trial in driven])
    return tally(errors[:, 0], errors[:, 1], [trial.reason for trial in driven])


def _totals(driven: Sequence[Driven]) -> dict[str, Any]:
    return {
        #: of all trials
        name: sum(getattr(trial, name) for trial in driven)
        for name in ("bytes_to_base", "bytes_from_base", "overruns")
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
        ("final position error", found.error_m, "mm"),
        ("final heading error", found.error_rad, "mrad"),
    ):
        p50, p95, most = (1000 * error for error in spread)
        yield f"{name}: median {p50:.0f}, 95th percentile {p95:.0f}, largest {most:.0f} {unit}"
    for reason, count in found.failures.items():
        yield f"not parked, {reason}: {count}"
    if more:
        yield f"{more['bytes_to_base']} bytes to the bases, {more['bytes_from_base']} from them"
    if "estimate" in more:
        yield from words(more["estimate"])
    if "times_real_time" in more:
        yield f"{more['times_real_time']:.0f} times real time"
    if "apart_m" in more:
        apart_m, apart_rad = more["apart_m"], more["apart_rad"]
        yield (
            f"live and virtual runs ended up to {1000 * apart_m['max']:.1f} mm and "
            f"{1000 * apart_rad['max']:.1f} mrad apart (median {1000 * apart_m['p50']:.1f} mm)"
        )
