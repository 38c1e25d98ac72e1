"""Commands of this package; heavy libraries load only when one runs."""

from typing import Annotated

import typer

Json = Annotated[bool, typer.Option("--json", help="Print one JSON object on stdout; text goes to stderr.")]


def bridge(json: Json = False) -> None:
    """Not there yet."""
    raise NotImplementedError
