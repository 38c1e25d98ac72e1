"""The command ``soak``; heavy libraries load only when it runs."""

from pathlib import Path
from typing import Annotated

import typer

from rover_ncp.core.console import Output
from rover_ncp.core.options import MOST_SEED, Json, Overwrite


def soak(
    *,
    minutes: Annotated[
        float, typer.Option(min=0.5, max=10_080.0, help="How long it lasts; all rows need about ten.")
    ] = 20.0,
    seed: Annotated[
        int, typer.Option(min=0, max=MOST_SEED, help="Decides the order, who drives and when it happens.")
    ] = 0,
    out: Annotated[Path, typer.Option(help="Folder for recordings, table and logs.")] = Path("runs/soak"),
    overwrite: Overwrite = False,
    json: Json = False,
) -> int:
    """Bring about every fault of the safety matrix, at random moments, in processes that live on.

    Mock Pioneer, bridge, links and drivers run as real processes on this machine. Each fault is measured:
    how soon the rover stood, by its true motion, against what docs/safety.md allows; then all is mended and
    the rover drives on. In the end it has to stand still, bridge and mock must hold no more memory, threads
    or sockets than in the beginning, and the recordings all that their drivers could hear.

        rover-ncp soak --minutes 20 --seed 1
        rover-ncp soak --minutes 2 --json

    A short one says which rows it did not reach. Ends with 0 if all is well, with 1 if not.
    """
    from sim.faults.soak_run import run_soak

    return run_soak(minutes, seed, out, Output(json), overwrite=overwrite)
