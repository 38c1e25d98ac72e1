"""Pages as files: of a recorded drive, or of a training run."""

from pathlib import Path
from typing import NamedTuple

from rover_ncp.core.errors import FileError
from rover_ncp.core.files import write_atomic
from rover_ncp.report.page import drive_page
from rover_ncp.report.recorded import read_drive

__all__ = ["Page", "write_page"]


class Page(NamedTuple):
    """A page that was written; ``kind`` is drive or training."""

    path: Path
    kind: str
    size: int


def write_page(source: Path, out: Path | None = None) -> Page:
    """Write the report of a recording beside it, or of a training run into its folder.

    Raises FileError and ConfigError.
    """
    if source.is_dir():
        raise FileError(f"{source}: is a folder")
    text, kind = drive_page(read_drive(source)), "drive"
    path = out or source.with_suffix(".html")
    write_atomic(path, text)
    return Page(path, kind, len(text.encode()))
