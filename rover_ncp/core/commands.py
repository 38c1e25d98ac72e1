"""Commands of this package; heavy libraries load only when one runs."""

import socket
from pathlib import Path
from typing import Annotated

import typer

from rover_ncp.core.console import Json, Output, Overwrite, reject
from rover_ncp.core.errors import UsageError


def keys(
    *,
    out: Annotated[Path, typer.Option(help="Folder for the files; it must not hold keys already.")],
    host: Annotated[
        list[str] | None,
        typer.Option(help="Name or IP address of the bridge's machine, as drivers use it; repeat for more."),
    ] = None,
    namespace: Annotated[str, typer.Option(help="The robot's namespace, such as bot1.")] = "",
    json: Json = False,
) -> None:
    """Make a certificate authority, and certificates for a bridge and its peers.

    Writes one Zenoh configuration for each end, which holds all that end needs: bridge.json5
    for 'rover-ncp bridge --zenoh-config', driver.json5 for 'rover-ncp deploy --zenoh-config',
    viewer.json5 for users who may watch but not drive, localiser.json5 for a localisation system that may
    only publish the rover's pose. With them both ends prove their identity, all traffic is encrypted, and
    each role has only the rights that the table of keys grants. ca-key.pem signs certificates: keep it off
    the robot.
    """
    from rover_ncp.core.credentials import make_credentials
    from rover_ncp.core.files import require_writable, write_atomic

    taken = [name.name for name in out.glob("*") if name.suffix in {".pem", ".json5"}] if out.is_dir() else []
    if taken:
        names = ", ".join(sorted(taken))
        raise UsageError(f"--out {out}: holds keys already ({names}); choose another folder")
    require_writable(out / "ca.pem")
    hosts = list(dict.fromkeys([*(host or []), "127.0.0.1", "localhost", socket.gethostname()]))
    files = make_credentials(hosts, namespace)
    for name, content in files.items():
        write_atomic(out / name, content, private=name != "ca.pem")
    Output(json).result(
        {"folder": str(out), "files": sorted(files), "hosts": hosts, "namespace": namespace},
        f"wrote {', '.join(sorted(files))} into {out}\n"
        f"the bridge may be called {', '.join(hosts)}\n"
        f"next, on the robot: rover-ncp bridge --base ... --zenoh-config {out}/bridge.json5\n"
        f"      at the desk:  rover-ncp deploy --robot tls/HOST --zenoh-config {out}/driver.json5",
    )


def recover(
    run: Annotated[Path, typer.Argument(help="A recording whose writer was killed, or whose disk failed.")],
    *,
    out: Annotated[
        Path | None, typer.Option(help="Write the whole recording here instead of in its place.")
    ] = None,
    overwrite: Overwrite = False,
    json: Json = False,
) -> None:
    """Make a recording whole that was cut off or damaged: every message before, and the index for viewers.

    Messages that a killed process had not yet written are lost, half a second at most. The file is replaced
    at once or not at all. A recording that is whole already stays as it is, and so does one that is still
    being written. Memory does not grow with the length of the recording.
    """
    from rover_ncp.core.files import require_creatable
    from rover_ncp.core.recording import recover as make_whole
    from rover_ncp.core.recording import require_finished

    if out is None:
        reject("needs --out", overwrite=overwrite)
    target = out or run
    if target == run:
        require_finished(run)
    require_creatable(target, overwrite=overwrite or target == run)
    found = make_whole(run, target)
    said = f"is whole again ({run.name} was {found.damage})" if found.damage else "was whole already"
    Output(json).result(
        {
            "recording": str(target),  #: the file that is whole
            "was_complete": not found.damage,  #: whether it was already
            "damage": found.damage or None,  #: where it was cut off or damaged
            "messages": found.messages,  #: how many
            "attachments": sorted(found.attachments),  #: their names
            "seconds": found.seconds,
        },
        f"{target} {said}: {found.messages} messages over {found.seconds:.1f} s, "
        f"{len(found.attachments)} attachments",
    )
