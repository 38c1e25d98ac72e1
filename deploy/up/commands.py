"""The commands ``up`` and ``stop``; heavy libraries load only when one runs."""

from pathlib import Path
from typing import Annotated

import typer

from deploy.options import Namespace, Robot, ZenohConfig, choose_robot
from rover_ncp.core.console import Json, Output


def up(
    *,
    robot: Annotated[
        str | None, typer.Option(help="The robot's file (YAML).", show_default="robot.yaml in this folder")
    ] = None,
    logs: Annotated[
        Path | None,
        typer.Option(help="Folder for what the processes print.", show_default="logs beside the file"),
    ] = None,
    json: Json = False,
) -> int:
    """Start what the robot's file names: the bridge, the localiser by tags and the live page.

    One line for each change of state; the rest goes to logs, which it names. The localiser and the page are
    started again when they end, less and less often. When the bridge ends, all end, with its exit code.
    Ctrl-C, SIGTERM and a closed terminal stop the rover first and then end all. If this command is killed,
    its processes end by themselves, and the bridge stops the rover.

    After a break of the line to the base it prints what to do. With 'resume: true' in the file it resumes the
    docking that the break interrupted, after a notice of 5 s and at most three times; never after a
    stop, a hazard, or odometry that restarted.

        rover-ncp up
        rover-ncp up --robot lab/robot.yaml

    Ends with the bridge's exit code, or with 3 if the bridge was killed.
    """
    from deploy.up.run import run
    from rover_ncp.robot.robot_file import require_robot_file

    file = require_robot_file(robot)
    settings = file.settings
    return run(
        file,
        logs or file.path.parent / "logs",
        Output(json, controls=True),
        localise=settings.tags is not None,
        page=settings.page is not None,
    )


def stop(
    *,
    robot: Robot = None,
    release: Annotated[
        bool, typer.Option("--release", help="End the stop: drivers may request the motors again.")
    ] = False,
    namespace: Namespace = "",
    zenoh_config: ZenohConfig = None,
    json: Json = False,
) -> int:
    """Stop the robot, from any terminal, until it is released.

    Prints the bridge's answer and whether odometry shows that the robot stands. It reaches the robot
    through the bridge: press the robot's own stop button where a person is in danger.

        rover-ncp stop
        rover-ncp stop --release

    Ends with 0 if the bridge confirms it, and with 1 if no confirmation came.
    """
    from deploy.stop import run

    address = choose_robot(robot, namespace, zenoh_config).address
    return run(address, Output(json), release=release)
