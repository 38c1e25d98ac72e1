"""The command ``eval``; heavy libraries load only when it runs."""

from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from rover_ncp.core.console import MAX_SEED, Json, Output, command, reject
from rover_ncp.core.errors import UsageError
from sim.world.bodies import BODY_WORDS, PRESET_WORDS, PRESETS, Body

if TYPE_CHECKING:
    from rover_ncp.robot.description import RobotDescription


class Sensors(StrEnum):
    """What the driver of a stack simulation has beside encoders."""

    ENCODERS = "encoders"
    GYRO = "gyro"
    CAMERA = "camera"
    BOTH = "both"


@dataclass(frozen=True, kw_only=True)
class EvalOptions:
    """Options of ``eval``."""

    policy: Annotated[
        str,
        typer.Argument(help="Policy to score: a name, a YAML file, or module:name for a policy in Python."),
    ]
    course: Annotated[
        list[str] | None,
        typer.Option(
            help="Course to drive, by name or YAML file; repeat for more, which trials take in turn.",
            show_default="parking",
        ),
    ] = None
    trials: Annotated[
        int | None,
        typer.Option(
            min=1,
            max=10**6,
            help="Number of trials, at least one for each course.",
            show_default="one for each course",
        ),
    ] = None
    seed: Annotated[
        int, typer.Option(min=0, max=MAX_SEED, help="Root seed of the trials and random courses.")
    ] = 0
    randomize: Annotated[
        str | None,
        typer.Option(
            help=f"Randomization of the trials: {PRESET_WORDS}; or a YAML file.",
            show_default="none; nominal; with --model the robot's own",
        ),
    ] = None
    model: Annotated[
        str | None,
        typer.Option(
            help="The robot's description, a name or a YAML file: its motion, size, sensors and, without "
            "--randomize, its ranges.",
            show_default="p3at-sh, as in the training",
        ),
    ] = None
    body: Annotated[Body, typer.Option(help=BODY_WORDS)] = Body.PYMUNK
    random_courses: Annotated[
        int | None,
        typer.Option(
            min=1, max=10_000, help="Number of random courses, driven in turn instead.", show_default=False
        ),
    ] = None
    stack: Annotated[
        bool,
        typer.Option("--stack", help="Drive through firmware, bridge and driver, on a virtual clock."),
    ] = False
    to: Annotated[
        str | None,
        typer.Option(
            help="With --stack: dock at a place (YAML) instead of driving a course, from 0.5 to 2.5 m and "
            "60° to either side of it. 'course' drives to the staging pose and the policy from there.",
            show_default=False,
        ),
    ] = None
    images: Annotated[
        bool,
        typer.Option(
            "--images", help="With --to: render the camera's pictures and localise by them (extra tag)."
        ),
    ] = False
    sensors: Annotated[
        Sensors | None,
        typer.Option(
            help="With --stack: what the driver has beside encoders: a gyro, a camera, both.",
            show_default="encoders; with --model the gyro that it describes",
        ),
    ] = None
    identify: Annotated[
        bool,
        typer.Option(
            "--identify", help="With --stack: identify each robot first, under the camera, on its ground."
        ),
    ] = False
    profile: Annotated[
        Path | None,
        typer.Option(
            help="Rover profile, as 'identify' writes it; values not in it are drawn.",
            show_default=False,
        ),
    ] = None
    processes: Annotated[
        int | None,
        typer.Option(
            min=1,
            max=1000,
            help="With --stack: number of processes. They change the speed, not the result.",
            show_default="one for each core",
        ),
    ] = None
    json: Json = False

    @property
    def courses(self) -> list[str]:
        """The names or files of the courses."""
        return self.course or ["parking"]

    @property
    def randomization(self) -> str | None:
        """The name or file of the randomization; None for the ranges of a described robot."""
        if self.randomize is not None or self.model is not None:
            return self.randomize
        return PRESETS[self.body][0]


@command
def evaluate(options: EvalOptions) -> int:
    """Drive a course in simulation with a policy, and score it.

    By default the policy drives once, on the nominal rover model.

    The return is the paper's: minus the squared errors at all checkpoints, 1 rad counting as 1 m. 0 is out of
    reach. A rover that does not move scores -14.18 on the parking course.

    With --randomize, the policy drives random trials. Each has its own delays, gains, noise and start, which
    follow from the seed and the trial's number alone. Without a randomization the trials of a course are the
    same: more than one for each course is an error. The true motion is scored.

        rover-ncp eval course --trials 1000 --randomize full
        rover-ncp eval course --trials 1000 --randomize full --random-courses 200

    --stack drives the same trials as encoded bytes through the firmware of a mock Pioneer, the bridge with
    its gate, and the driver with its estimator. Only sockets and waiting differ from driving a robot. The
    driver knows what --model and --profile tell it, and the noise of the odometry.

        rover-ncp eval course --trials 300 --randomize full --stack

    --body mujoco drives a rover with four wheels, friction, weight and motors, which can have a slope or
    cables under it. It does not move as the body of the training does: it turns more than its encoders
    report, and slides. --sensors gives the driver a gyro or a camera.

        rover-ncp eval course --trials 300 --stack --body mujoco --randomize varied --sensors gyro

    --model names another robot: its size, motion, delays and sensors, and the ranges in which robots of that
    model differ. A course becomes slower for a robot that is slower than a circuit's commands, and one with
    obstacles becomes larger for a larger robot; the result says so.

        rover-ncp eval course --trials 300 --stack --model turtlebot4

    module:name in place of a policy is a function of your own, or a class of such, in a module that Python
    finds, also in the working folder. It gets the signals that its attribute signals names, and returns v and
    omega. A method reset, if there is one, begins each trial.

        rover-ncp eval my_policy:Follow --trials 100 --randomize full

    --to docks at a place with a camera on the robot that sees tags there, by a noise model (docs/place.md).
    Docked is judged by the true pose.

        rover-ncp eval dock --stack --to home.yaml --trials 30 --body mujoco --randomize varied

    Ends with 1 if a single trial was driven and did not park, else with 0.
    """
    if not options.stack:
        if options.body is Body.MUJOCO:
            raise UsageError("--body mujoco needs --stack: plain simulation is pymunk's")
        for name in ("to", "images", "sensors", "identify", "processes"):
            if getattr(options, name):
                raise UsageError(f"--{name} needs --stack")
    if options.identify and options.profile is not None:
        raise UsageError("--identify and --profile do not go together: both tell the driver of the robot")
    if options.to is not None:
        return _dock(options, options.to)
    reject("needs --to", images=options.images)
    random = (options.trials, options.randomize, options.random_courses, options.profile)
    if random == (None,) * 4 and not options.stack and len(options.courses) == 1:
        return _drive_once(options)
    return _drive_trials(options)


def _drive_once(options: EvalOptions) -> int:
    """Drive once on the nominal rover model."""
    from rover_ncp.course.course import load_course
    from rover_ncp.robot.description import load_description
    from sim.evaluate.evaluate import fitted_courses
    from sim.evaluate.results import DriveOnceResult
    from sim.learn.engine.driver import load_driver
    from sim.learn.engine.rollout import rollout
    from sim.world.described import described_rover

    robot = None if options.model is None else load_description(options.model)
    (course,), scaled = fitted_courses([load_course(name) for name in options.courses], robot)
    driver, model = load_driver(options.policy), described_rover(robot) if robot else None
    run = rollout(driver.signals, course, model, runner=driver.runner())
    verdict = run.verdict
    result = DriveOnceResult(
        return_=run.total, **vars(verdict), rms_m=run.rms_m, model=options.model, scaled=scaled
    )
    ending = "parked" if verdict.parked else f"not parked: {verdict.reason}"
    Output(options.json).result(
        result,
        "".join(f"{line}\n" for line in scaled)
        + f"{ending}; return {run.total:.4f}; final errors {1000 * verdict.error_m:.0f} mm and "
        f"{1000 * verdict.error_rad:.0f} mrad; {1000 * run.rms_m:.0f} mm rms from the checkpoints",
    )
    return 0 if verdict.parked else 1


def _drive_trials(options: EvalOptions) -> int:
    """Drive random trials; return 1 if a single one was driven and did not park."""
    from rover_ncp.course.course import load_course
    from rover_ncp.robot.description import load_description
    from sim.evaluate.evaluate import drive_trials, fitted_courses, tally, trial_count, unseen_courses
    from sim.evaluate.results import StackTrialsResult, TrialsResult
    from sim.evaluate.trial_runs import evaluate_stack, result_words
    from sim.learn.engine.driver import load_driver
    from sim.stack.trials import Stack
    from sim.world.described import described_rover, ranges_for

    output, seed, in_stack = Output(options.json), options.seed, None
    robot = None if options.model is None else load_description(options.model)
    if options.random_courses:
        courses = unseen_courses(seed, options.random_courses)
    else:
        courses = [load_course(name) for name in options.courses]
    courses, scaled = fitted_courses(courses, robot)
    ranges = ranges_for(options.randomization, options.profile, options.body, robot)
    driver = load_driver(options.policy)
    if options.stack:
        gyro, camera = driver_sensors(options.sensors, robot)
        stack = Stack(driver, tuple(courses), ranges, seed, gyro, camera, options.identify, robot)
        trials = trial_count(options.trials, len(courses), ranges, stack.varies)
        found, in_stack = evaluate_stack(stack, trials, options.processes)
    else:
        trials = trial_count(options.trials, len(courses), ranges, ranges.varies)
        model = described_rover(robot) if robot else None
        found = tally(drive_trials(driver, courses, ranges, trials=trials, seed=seed, model=model))
    fields = dict(
        **vars(found),
        randomize=options.randomization or ranges.name,
        model=options.model,
        scaled=scaled,
        body=options.body.value,
        seed=seed,
        random_courses=options.random_courses or 0,
        course=",".join(options.courses),
    )
    result = StackTrialsResult(**fields, **vars(in_stack)) if in_stack else TrialsResult(**fields)
    output.result(result, "\n".join([*scaled, *result_words(found, in_stack)]))
    return 1 if found.trials == 1 and found.success_rate < 1 else 0


def _dock(options: EvalOptions, name: str) -> int:
    """Dock in random trials; return 1 if a single one was driven and did not dock."""
    from deploy.place.place import load_place
    from rover_ncp.circuit.policy_file import load_policy
    from rover_ncp.robot.description import load_description
    from sim.evaluate.docking_runs import docking_words, evaluate_docking
    from sim.stack.docking import DockTrials
    from sim.stack.tag_camera import TagLocaliser
    from sim.world.described import ranges_for

    given = {"course": options.course, "identify": options.identify, "profile": options.profile}
    reject("does not go with --to", **given, random_courses=options.random_courses)
    robot = None if options.model is None else load_description(options.model)
    ranges = ranges_for(options.randomization, None, options.body, robot)
    gyro, _ = driver_sensors(options.sensors or (None if robot else Sensors.GYRO), robot)
    place, output = load_place(name), Output(options.json)
    localiser = TagLocaliser
    if options.images:
        from sim.stack.rendered_camera import RenderedLocaliser

        localiser = RenderedLocaliser
    trials = DockTrials(
        load_policy("course"),
        load_policy(options.policy),
        place,
        ranges,
        options.seed,
        gyro=gyro,
        robot=robot,
        localiser=localiser,
    )
    about = {"randomize": options.randomization or ranges.name, "model": options.model}
    about["body"] = options.body.value
    found = evaluate_docking(trials, options.trials or 1, options.processes, **about)
    output.result(found, "\n".join(docking_words(found)))
    return 1 if found.trials == 1 and found.success_rate < 1 else 0


def driver_sensors(sensors: Sensors | None, robot: "RobotDescription | None") -> tuple[bool, bool]:
    """Return whether the driver has a gyro, and a camera. Raises UsageError."""
    if sensors is None:
        return robot is not None and robot.gyro is not None, False
    gyro = sensors in {Sensors.GYRO, Sensors.BOTH}
    if gyro and robot is not None and robot.arcos is None and robot.gyro is None:
        raise UsageError(f"--sensors {sensors}: {robot.name} has no gyro")
    return gyro, sensors in {Sensors.CAMERA, Sensors.BOTH}
