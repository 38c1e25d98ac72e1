"""The command ``recover``; heavy libraries load only when it runs."""

from pathlib import Path
from typing import Annotated

import typer

from rover_ncp.core.console import Json, Output, Overwrite, reject


def recover(
    run: Annotated[Path, typer.Argument(help="A recording whose writer was killed, or whose disk failed.")],
    *,
    out: Annotated[
        Path | None, typer.Option(help="Write the whole recording here instead of in its place.")
    ] = None,
    overwrite: Overwrite = False,
    json: Json = False,
) -> None:
    """Repair a recording that was cut off or damaged: keep each message before, and write viewers' index.

    Messages that a killed process had not yet written are lost, at most the last half second. The file is
    replaced in one step or not at all. A recording that is whole already stays as it is, and so does one that
    is still being written. Memory does not grow with the length of the recording. For recordings of other
    software there is 'mcap recover'.

        rover-ncp recover run.mcap
    """
    from rover_ncp.core.files import require_writable
    from rover_ncp.recording.recording import recover as make_whole
    from rover_ncp.recording.recording import require_finished

    if out is None:
        reject("needs --out", overwrite=overwrite)
    target = out or run
    if target == run:
        require_finished(run)
    require_writable(target, overwrite=overwrite or target == run)
    found = make_whole(run, target)
    said = f"is whole again ({run.name} was {found.damage})" if found.damage else "was whole already"
    Output(json).result(
        found,
        f"{target} {said}: {found.messages} messages over {found.seconds:.1f} s, "
        f"{len(found.attachments)} attachments",
    )
