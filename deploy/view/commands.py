"""The command ``report``; heavy libraries load only when it runs."""

from pathlib import Path
from typing import Annotated

import typer

from rover_ncp.core.console import Json, Output, Overwrite


def report(
    source: Annotated[Path, typer.Argument(help="A recording (.mcap) of a drive.")],
    *,
    out: Annotated[Path | None, typer.Option(help="The page to write.", show_default="RUN.html")] = None,
    overwrite: Overwrite = False,
    json: Json = False,
) -> None:
    """Write a page about a drive: one HTML file, to be opened from disk.

    The page shows the path, every neuron and synapse, the driver's commands and the gate's setpoints over one
    time slider, with a sentence for each phase of the manoeuvre. It holds all its data and loads nothing from
    the network.

        rover-ncp report run.mcap --out run.html
    """
    from deploy.view.page import write_report
    from rover_ncp.core.files import existing_file

    page = out or existing_file(source).with_suffix(".html")
    found = write_report(source, page, overwrite=overwrite)
    Output(json).result(found, f"report: {found.page}")
