"""Pages as files: of a recorded drive, or of a training run."""

from pathlib import Path
from typing import NamedTuple

from deploy.report.page.page import TRAINING, drive_page, html
from deploy.report.page.page_data import course_data
from deploy.report.recorded_drive import read_drive
from rover_ncp.core.files import existing_file, require_writable, write_atomic
from sim.explain.training import Training, read_training, training_data


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
        kind, path = "training", out or source / "report.html"
    else:
        kind, path = "drive", out or existing_file(source).with_suffix(".html")
    require_writable(path)
    text = _training_page(read_training(source)) if kind == "training" else drive_page(read_drive(source))
    write_atomic(path, text)
    return Page(path, kind, len(text.encode()))


def _training_page(training: Training) -> str:
    data = {"course": course_data(training.course), **training_data(training)}
    return html(f"{data['headline']} ({training.record.settings.course})", data, TRAINING)
