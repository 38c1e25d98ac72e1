"""Options of the command ``eval``."""

from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from rover_ncp.core.console import MAX_SEED, Json, Overwrite
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


class Scene(StrEnum):
    """What hangs at a place, by the name of its class in `sim.stack.board_scenes`."""

    TAGS = "tags"
    BOARD = "board"
    WRONG_MOUNT = "wrong-mount"
    SECOND_BOARD = "second-board"
    SECOND_PRINT = "second-print"
    SIDEWAYS = "sideways"


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
    scene: Annotated[
        Scene | None,
        typer.Option(
            help="With --images: what hangs at the place. tags: three tags whose places are known; board: a "
            "board; wrong-mount: a camera's file that errs by 2 cm and 2°; second-board: another one beside; "
            "second-print: of the same one, 3 m away; sideways: turned by 90° since it was taught.",
            show_default="tags",
        ),
    ] = None
    blind: Annotated[
        bool, typer.Option("--blind", help="With --images: start with no tag in view, at any heading.")
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
    card: Annotated[
        bool,
        typer.Option(
            "--card", help="Measure a circuit under the conditions of a card, and write it: NAME.card.md."
        ),
    ] = False
    overwrite: Overwrite = False
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


def driver_sensors(sensors: Sensors | None, robot: "RobotDescription | None") -> tuple[bool, bool]:
    """Return whether the driver has a gyro, and a camera. Raises UsageError."""
    if sensors is None:
        return robot is not None and robot.gyro is not None, False
    gyro = sensors in {Sensors.GYRO, Sensors.BOTH}
    if gyro and robot is not None and robot.arcos is None and robot.gyro is None:
        raise UsageError(f"--sensors {sensors}: {robot.name} has no gyro")
    return gyro, sensors in {Sensors.CAMERA, Sensors.BOTH}
