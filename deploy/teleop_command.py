"""The ``teleop`` command; heavy libraries load only when it runs."""

from pathlib import Path
from typing import Annotated

import typer

from deploy.options import Namespace, Robot, ZenohConfig
from rover_ncp.core.console import Json, Output, Overwrite, reject


def teleop(
    *,
    robot: Robot,
    record: Annotated[
        Path | None,
        typer.Option(help="Record the drive to this MCAP file; 'rover-ncp course new' makes a course of it."),
    ] = None,
    overwrite: Overwrite = False,
    namespace: Namespace = "",
    zenoh_config: ZenohConfig = None,
    json: Json = False,
) -> int:
    """Drive the robot behind a bridge with the keyboard: hold a key to drive, release it to stop.

    u i o, j k l and m , . drive in the direction in which they lie around k, which stops; the arrows do as
    i , j l. A terminal reports a held key only by repeating it, so a key counts for 0.4 s after it was last
    sent. A single press is a small step at half speed. q and Ctrl-C stop the rover and release the lease.

    It drives through the same lease, gate and limits as 'rover-ncp deploy'. Ends with 0, 3 no bridge, no
    robot, not authorised or another driver, 4 stopped by a safety rule, which is named, 130 Ctrl-C.
    """
    from deploy.recorder import Recorder
    from deploy.teleop import run
    from deploy.zenoh_client import BridgeAddress

    if record is None:
        reject("needs --record", overwrite=overwrite)
    address = BridgeAddress(robot, namespace, zenoh_config)
    return run(address, Recorder(record, overwrite=overwrite), Output(json, controls=True))
