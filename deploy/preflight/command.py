"""The ``check`` command; heavy libraries load only when it runs."""

import signal
from pathlib import Path
from typing import Annotated

import typer

from rover_ncp.core.console import Output, printable
from rover_ncp.core.errors import UsageError


def check(
    *,
    robot: Annotated[
        str,
        typer.Option(help="Where the bridge listens: PROTOCOL/HOST[:PORT], such as tcp/192.168.1.20."),
    ],
    on_blocks: Annotated[
        bool, typer.Option("--on-blocks", help="The wheels are off the ground: they are going to turn.")
    ] = False,
    namespace: Annotated[str, typer.Option(help="The robot's namespace, such as bot1.")] = "",
    zenoh_config: Annotated[
        Path | None, typer.Option(help="Zenoh configuration (JSON5) with certificates or user and password.")
    ] = None,
    json: Annotated[
        bool, typer.Option("--json", help="Print one JSON object on stdout; text goes to stderr.")
    ] = False,
) -> int:
    """Check a robot before it drives: on blocks, its wheels free.

    Checks odometry, battery, stop button and bumpers and takes the motors. Turns the wheels forward and then
    left for a moment and compares the reported motion with the commands. Ends with a test of the stop: it
    sends no more commands and measures how long the wheels go on. Ends with 0 for yes, 1 for no, with the
    reason.
    """
    if not on_blocks:
        raise UsageError("the wheels are going to turn: put the robot on blocks and say --on-blocks")
    from deploy.drive.link import Link
    from deploy.preflight.preflight import Preflight

    output = Output(json, controls=True)
    preflight = Preflight()
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        with Link(robot, namespace, zenoh_config, preflight.record) as link:
            findings = preflight.run(link)
    finally:
        signal.signal(signal.SIGTERM, before)
    ready = all(finding.ok for finding in findings)
    lines = [f"{'ok ' if finding.ok else 'NO '} {finding.name:9} {finding.detail}" for finding in findings]
    verdict = "yes: it may drive" if ready else f"no: {findings[-1].name}: {findings[-1].detail}"
    output.result(
        {"ready": ready, "findings": [vars(finding) for finding in findings], "robot": link.robot},
        "\n".join(map(printable, [*lines, verdict])),
    )
    return 0 if ready else 1
