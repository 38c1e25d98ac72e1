"""The command ``bench``; heavy libraries load only when it runs."""

from enum import StrEnum
from typing import Annotated

import typer

from rover_ncp.core.console import Json, Output


class What(StrEnum):
    """Measurements of the benchmark."""

    DEPLOY = "deploy"


def bench(
    what: Annotated[What, typer.Argument(help="deploy: the driver's response time.")],
    *,
    seconds: Annotated[
        float, typer.Option(min=2.0, max=86_400.0, help="Duration in s of each rate's measurement.")
    ] = 60.0,
    json: Json = False,
) -> int:
    """Measure the driver's response time.

    deploy measures the time from an odometry sample to its command at 10, 50 and 100 samples a second, beside
    a bare round trip of the same bytes, the ticks' jitter and the share of a core. It also measures the
    circuit's part of that time, and whether the whole driver can run 500 times a second. On a busy machine a
    safety rule may stop a drive: the other rates are measured all the same, and the command ends with 1.

        rover-ncp bench deploy --seconds 10
    """
    from sim.benchmarks.deploy import bench_deploy

    output = Output(json)
    found = bench_deploy(seconds, output.say)
    words = [
        f"{rate.rate_hz:.0f} Hz: {rate.above_bare_ms.p99:.2f} ms above the bare half round trip "
        "(99th percentile)"
        for rate in found.rates
        if rate.above_bare_ms is not None
    ]
    output.result(found, "\n".join(words) or "no rate was measured")
    return 0 if len(words) == len(found.rates) and not found.fastest.stopped else 1
