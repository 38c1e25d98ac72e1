"""The command ``bench``; heavy libraries load only when it runs."""

from typing import Annotated, Literal

import typer

from rover_ncp.core.console import Json, Output


def bench(
    what: Annotated[Literal["deploy"], typer.Argument(help="deploy: the driver's response time.")],
    *,
    seconds: Annotated[
        float, typer.Option(min=2.0, max=86_400.0, help="Duration in s of each rate's measurement.")
    ] = 60.0,
    json: Json = False,
) -> int:
    """Measure the driver's response time.

    That is the time from an odometry sample to its command, at 10, 50 and 100 samples a second, and the share
    of a core. The circuit's part of that time is measured too. On a busy machine a safety rule may stop a
    drive: the other rates are measured all the same, and the command ends with 1.

        rover-ncp bench deploy --seconds 10
    """
    from sim.benchmarks.deploy import bench_deploy

    output = Output(json)
    found = bench_deploy(seconds, output.say)
    words = [
        f"{rate.rate_hz:.0f} Hz: {rate.odometry_to_command_ms.p99:.2f} ms from odometry to command "
        "(99th percentile)"
        for rate in found.rates
        if rate.odometry_to_command_ms is not None
    ]
    output.result(found, "\n".join(words) or "no rate was measured")
    return 0 if len(words) == len(found.rates) else 1
