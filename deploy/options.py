"""Options that several commands of this package share."""

from pathlib import Path
from typing import Annotated

import typer

Robot = Annotated[
    str, typer.Option(help="Where the bridge listens: PROTOCOL/HOST[:PORT], such as tcp/192.168.1.20.")
]
Namespace = Annotated[str, typer.Option(help="The robot's namespace, such as bot1.")]
ZenohConfig = Annotated[Path | None, typer.Option(help="Zenoh configuration (JSON5) with certificates.")]
