"""Options that every command has; no heavy import, as ``--help`` reads this."""

from typing import Annotated

import typer

Json = Annotated[bool, typer.Option("--json", help="Print one JSON object on stdout; text goes to stderr.")]
MOST_SEED = 2**63 - 1
"""Of a seed, or of the number of a trial."""
Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace recordings that exist already.")]
