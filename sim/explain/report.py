"""The report of a drive as files, in a module of its own: ``explain`` does without the extra ``report``."""

from pathlib import Path

from deploy.report.charts.animation import FORMATS, animate
from deploy.report.page.page import drive_page
from deploy.report.recorded_drive import read_drive
from rover_ncp.core.errors import UsageError
from rover_ncp.core.files import existing_file, require_writable, write_atomic


def write_page(source: Path, out: Path | None = None) -> Path:
    """Write the report of a recording, beside it by default, and return its path.

    Raises FileError and ConfigError.
    """
    path = out or existing_file(source).with_suffix(".html")
    require_writable(path)
    write_atomic(path, drive_page(read_drive(source)))
    return path


def write_animation(source: Path, out: Path) -> None:
    """Write a recorded drive as an animated picture. Raises FileError, ConfigError and UsageError."""
    if out.suffix not in FORMATS:
        raise UsageError(f"--animation {out}: expected a file that ends in {' or '.join(FORMATS)}")
    require_writable(out)
    drive = read_drive(source)
    write_atomic(out, animate(drive.timeline.trace(), drive.course, out.suffix))
