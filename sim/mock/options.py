"""The options of ``mock``; light, as the command line reads it."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from bridge.ros2.discovery import Convention
from rover_ncp.core.console import MAX_SEED, Json, Overwrite
from rover_ncp.core.files import DEFAULT_ROBOT
from sim.base.faults import FAULTS
from sim.world.bodies import BODY_WORDS, PRESET_WORDS, Body


@dataclass(frozen=True, kw_only=True)
class MockOptions:
    """Options of ``mock``."""

    listen: Annotated[str, typer.Option(help="HOST:PORT to wait on; port 0 takes a free one.")] = (
        "127.0.0.1:8101"
    )
    model: Annotated[
        str,
        typer.Option(help="p3at, p3at-sh, p3dx or p3dx-sh; with --ros2 a description: a name or file."),
    ] = DEFAULT_ROBOT
    ros2: Annotated[
        bool, typer.Option("--ros2", help="Simulate a ROS 2 robot, whose topics are on Zenoh.")
    ] = False
    ros: Annotated[
        Convention | None,
        typer.Option(
            help="With --ros2: the form of its topics on Zenoh; the domain is ROS_DOMAIN_ID.",
            show_default="ros2dds",
        ),
    ] = None
    namespace: Annotated[str, typer.Option(help="With --ros2: prefix of its topics.")] = ""
    course: Annotated[
        str | None, typer.Option(help="Put this course's obstacles around the rover: a name or a file.")
    ] = None
    truth: Annotated[
        Path | None, typer.Option(help="Write the rover's true pose to this CSV file, 100 times a second.")
    ] = None
    overwrite: Overwrite = False
    fault: Annotated[
        list[str] | None,
        typer.Option(
            help="Inject a fault, NAME[=VALUE][@START[-END]]; repeat for more. Seconds count from when "
            f"the motors are first enabled. Names: {', '.join(FAULTS)}. '-' reads more faults from "
            "standard input, one a line; their seconds count from when the line is read."
        ),
    ] = None
    body: Annotated[Body, typer.Option(help=BODY_WORDS)] = Body.PYMUNK
    randomize: Annotated[
        str | None,
        typer.Option(
            help=f"Simulate a randomised robot: {PRESET_WORDS}.",
            show_default="none; nominal",
        ),
    ] = None
    trial: Annotated[
        int,
        typer.Option(min=0, max=MAX_SEED, help="Number of the random trial, as in 'eval --trials'."),
    ] = 0
    profile: Annotated[
        Path | None,
        typer.Option(
            help="Simulate this robot: a rover profile, as 'identify' writes it.", show_default=False
        ),
    ] = None
    seed: Annotated[
        int,
        typer.Option(
            min=0,
            max=MAX_SEED,
            help="Seed of the trial, of the packets that random faults damage, and of the noise of sensors "
            "and camera.",
        ),
    ] = 0
    camera: Annotated[
        Path | None,
        typer.Option(help="Serve pictures of this camera (YAML, see 'tag') as MJPEG.", show_default=False),
    ] = None
    tags: Annotated[
        Path | None, typer.Option(help="With --camera: the tags that it sees (YAML).", show_default=False)
    ] = None
    camera_listen: Annotated[
        str | None,
        typer.Option(help="With --camera: where its stream is served.", show_default="127.0.0.1:8102"),
    ] = None
    gyro: Annotated[bool, typer.Option("--gyro", help="Give the base a gyro that its client reads.")] = False
    json: Json = False
