"""The ``identify`` command; heavy libraries load only when it runs."""

from pathlib import Path
from typing import Annotated

import typer

from rover_ncp.core.console import Output, Overwrite


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
    out: Annotated[Path, typer.Option(help="The rover profile to write (YAML).")] = Path("rover.yaml"),
    fence: Annotated[
        float, typer.Option(min=0.1, max=5.0, help="How far from its start the rover may come, m.")
    ] = 0.8,
    record: Annotated[
        Path | None, typer.Option(help="Record the drive to this MCAP file.", show_default=False)
    ] = None,
    overwrite: Overwrite = False,
    namespace: Annotated[str, typer.Option(help="The robot's namespace, such as bot1.")] = "",
    zenoh_config: Annotated[
        Path | None, typer.Option(help="Zenoh configuration (JSON5) with certificates or user and password.")
    ] = None,
    json: Annotated[
        bool, typer.Option("--json", help="Print one JSON object on stdout; text goes to stderr.")
    ] = False,
) -> int:
    """Measure a robot: its delays, accelerations, gains and noise, as a profile.

    Drives for a minute, forward and back by half a metre, then left and right, at walking pace, through the
    same lease and gate as 'rover-ncp deploy'; keep a circle of --fence metres around it free. Ctrl-C stops
    the rover. A recording of another drive determines fewer values: delays, gains and accelerations need
    several steps of the command with pauses between. Each value is shown ± its standard deviation: 1.96 of
    them on both sides hold the truth 19 times in 20. It is left out when that is too wide.

        rover-ncp identify --robot tcp/192.168.1.20 --out mine.yaml
        rover-ncp eval course --trials 300 --randomize full --profile mine.yaml
        rover-ncp deploy --robot tcp/192.168.1.20 --policy course --profile mine.yaml

    Gains are those that odometry sees. With external poses on 'pose' during the drive, gains are separated
    from odometry's own errors, and slip and imbalance are found too.

    Ends with 0, 1 when a delay or gain could not be determined, 3 no bridge, no robot, not authorised or
    another driver, 4 stopped by a safety rule, which is named, 130 Ctrl-C.
    """
    from deploy.identify.run import Options, run

    options = Options(recording, robot, out, fence, record, overwrite, namespace, zenoh_config)
    return run(options, Output(json, controls=True))
