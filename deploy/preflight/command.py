"""The ``check`` command; heavy libraries load only when it runs."""

from typing import Annotated

import typer

from deploy.options import Namespace, Robot, ZenohConfig
from rover_ncp.core.console import Json, Output, printable
from rover_ncp.core.errors import UsageError


def check(
    *,
    robot: Robot,
    on_blocks: Annotated[
        bool, typer.Option("--on-blocks", help="The wheels are off the ground; the check turns them.")
    ] = False,
    model: Annotated[
        str | None,
        typer.Option(
            help="The robot's description, a name or a YAML file: what the bridge must drive, at its rate.",
            show_default=False,
        ),
    ] = None,
    namespace: Namespace = "",
    zenoh_config: ZenohConfig = None,
    json: Json = False,
) -> int:
    """Check a robot before it drives: on blocks, its wheels free.

    Checks odometry, battery, stop button and bumpers and requests the motors. Turns the wheels forward and
    then left for a moment and compares the reported motion with the commands. Ends with a test of the stop:
    it sends no more commands and measures how long the wheels go on. For a ROS 2 robot the bridge then sends
    nothing either, for 5 s at most, and measures when the robot halts by itself. Ends with 0 for yes, 1 for
    no, with the reason.
    """
    if not on_blocks:
        raise UsageError("the check turns the wheels: put the robot on blocks and give --on-blocks")
    from deploy.preflight.preflight import run
    from deploy.zenoh_client import BridgeAddress
    from rover_ncp.core.robot_description import load_description

    output = Output(json, controls=True)
    described = load_description(model) if model else None
    findings, locator = run(BridgeAddress(robot, namespace, zenoh_config), described)
    ready = all(finding.ok for finding in findings)
    lines = [f"{'ok ' if finding.ok else 'NO '} {finding.name:9} {finding.detail}" for finding in findings]
    verdict = "yes: it may drive" if ready else f"no: {findings[-1].name}: {findings[-1].detail}"
    output.result(
        {"ready": ready, "findings": findings, "robot": locator},
        "\n".join(map(printable, [*lines, verdict])),
    )
    return 0 if ready else 1
