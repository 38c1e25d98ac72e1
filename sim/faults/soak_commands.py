"""The command ``soak``; heavy libraries load only when it runs."""

from pathlib import Path
from typing import Annotated

import typer

from rover_ncp.core.console import MOST_SEED, Json, Output, Overwrite


def soak(
    *,
    minutes: Annotated[
        float, typer.Option(min=0.5, max=10_080.0, help="Duration in minutes; all rows need about ten.")
    ] = 20.0,
    seed: Annotated[
        int,
        typer.Option(
            min=0, max=MOST_SEED, help="Seed of the order, the drivers and the times of the faults."
        ),
    ] = 0,
    out: Annotated[Path, typer.Option(help="Folder for recordings, table and logs.")] = Path("runs/soak"),
    overwrite: Overwrite = False,
    json: Json = False,
) -> int:
    """Inject every fault of the safety matrix, at random moments, in processes that keep running.

    Mock Pioneer, bridge, links and drivers run as real processes on this machine. For each fault the time to
    standstill is measured, by the rover's true motion, and compared with the bound of docs/safety.md. Then
    the fault is removed and the rover drives again. At the end the rover must stand still. Bridge and mock
    must hold no more memory, threads or sockets than at the beginning. The recordings must hold every message
    that their drivers could receive.

        rover-ncp soak --minutes 20 --seed 1
        rover-ncp soak --minutes 2 --json

    A short soak lists the rows that it did not reach. Exits with 0 if every check passed, else with 1.
    """
    from sim.faults.soak_run import run_soak

    return run_soak(minutes, seed, out, Output(json), overwrite=overwrite)
