"""The report of a drive as files, in a module of its own: ``explain`` does without the extra ``report``."""

from pathlib import Path

from deploy.view.page import drive_page
from deploy.view.recorded_drive import read_drive
from rover_ncp.core.files import existing_file, require_writable, write_atomic


def write_page(source: Path, out: Path | None = None) -> Path:
    """Write the report of a recording, beside it by default, and return its path.

    Raises FileError and ConfigError.
    """
    path = out or existing_file(source).with_suffix(".html")
    require_writable(path)
    write_atomic(path, drive_page(read_drive(source)))
    return path
