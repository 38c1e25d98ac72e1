"""The command ``setup``; heavy libraries load only when it runs."""

import sys
from pathlib import Path
from typing import Annotated

import typer

from rover_ncp.core.console import Json, Output, Overwrite, print_line, reject


def setup(
    *,
    robot: Annotated[
        Path, typer.Option(help="The robot's file to write; its values are the defaults if it exists.")
    ] = Path("robot.yaml"),
    print_: Annotated[
        bool, typer.Option("--print", help="Print the file with all keys and their meaning, and ask nothing.")
    ] = False,
    overwrite: Overwrite = False,
    json: Json = False,
) -> int:
    """Write robot.yaml, the file of one robot that all commands read: find what can be found, ask the rest.

    Looks for serial ports, a ROS 2 robot's Zenoh router and cameras. It sends nothing to a serial device, and
    moves no robot, unless you agree. Each question says why it is asked and has a default. If you agree, it
    measures when a ROS 2 robot halts by itself, and runs the check at the end. Without a terminal it says
    what is missing (2).

        rover-ncp setup
        rover-ncp setup --print
    """
    from bridge.setup.run import run
    from rover_ncp.robot.robot_file import commented, load_robot_file

    if print_:
        reject("does not go with --print, which prints YAML", overwrite=overwrite, json=json)
        known = load_robot_file(robot).settings if robot.exists() else None
        for line in commented(known).splitlines():
            print_line(sys.stdout, line)
        return 0
    return run(robot, Output(json), overwrite=overwrite, terminal=sys.stdin.isatty())
