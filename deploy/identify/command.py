"""The ``identify`` command; heavy libraries load only when it runs."""

from pathlib import Path
from typing import Annotated

import typer

from deploy.options import Namespace, ZenohConfig
from rover_ncp.core.console import Json, Output, Overwrite, reject
from rover_ncp.core.errors import UsageError


def identify(
    recording: Annotated[
        Path | None,
        typer.Argument(help="A recording of a drive, instead of driving one.", show_default=False),
    ] = None,
    *,
    robot: Annotated[
        str | None,
        typer.Option(
            help="Drive this robot: where its bridge listens, PROTOCOL/HOST[:PORT], tcp/192.168.1.20.",
            show_default=False,
        ),
    ] = None,
    model: Annotated[
        str | None,
        typer.Option(
            help="The robot's description, a name or a YAML file: steps are no faster than it drives.",
            show_default=False,
        ),
    ] = None,
    out: Annotated[Path, typer.Option(help="The rover profile to write (YAML).")] = Path("rover.yaml"),
    fence: Annotated[
        float | None,
        typer.Option(
            min=0.1, max=5.0, help="How far from its start the rover may come, m.", show_default="0.8"
        ),
    ] = None,
    record: Annotated[
        Path | None, typer.Option(help="Record the drive to this MCAP file.", show_default=False)
    ] = None,
    overwrite: Overwrite = False,
    namespace: Namespace = "",
    zenoh_config: ZenohConfig = None,
    json: Json = False,
) -> int:
    """Measure a robot: its delays, accelerations, gains and noise, as a profile.

    Drives for a minute, forward and back by half a metre, then left and right, at walking pace, through the
    same lease and gate as 'rover-ncp deploy'; keep a circle of --fence metres around it free. Ctrl-C stops
    the rover. A recording of another drive determines fewer values: delays, gains and accelerations need
    several steps of the command with pauses between. Each value is shown ± its standard deviation: 1.96 of
    them on both sides are a 95 % interval. A value with too large a deviation is left out.

        rover-ncp identify --robot tcp/192.168.1.20 --out mine.yaml
        rover-ncp eval course --trials 300 --randomize full --profile mine.yaml
        rover-ncp deploy --robot tcp/192.168.1.20 --policy course --profile mine.yaml

    Gains are those that odometry measures. With external poses on 'pose' during the drive, gains are
    separated from odometry's own errors, and slip, imbalance and centre of rotation are found too.

    Ends with 0, 1 when a delay or gain could not be determined, 3 no bridge, no robot, not authorised or
    another driver, 4 stopped by a safety rule, which is named, 130 Ctrl-C.
    """
    if (recording is None) == (robot is None):
        raise UsageError("expected either --robot to drive one, or a recording of a drive")
    output = Output(json, controls=True)
    from deploy.identify.excitation import FENCE_M
    from deploy.identify.run import identify_recording, identify_robot
    from deploy.recorder import Recorder
    from deploy.zenoh_client import BridgeAddress
    from rover_ncp.robot.description import load_description

    if robot is None:
        assert recording is not None
        reject(
            "needs --robot",
            model=model,
            fence=fence,
            record=record,
            overwrite=overwrite,
            namespace=namespace,
            zenoh_config=zenoh_config,
        )
        return identify_recording(recording, out, output)
    if record is None:
        reject("needs --record", overwrite=overwrite)
    address = BridgeAddress(robot, namespace, zenoh_config)
    described = load_description(model) if model else None
    return identify_robot(
        address, Recorder(record, overwrite=overwrite), fence or FENCE_M, out, output, robot=described
    )
