"""The folder of a training run. Every file is written whole or not at all, so a run may be killed any time.

settings.yaml   the record, written first
policy.yaml     the best policy
curve.csv       the learning curve
agents/NN.json  an agent that has ended: its parameters and its curve
agents/NN.yaml  its policy, at the end of the run
curve.png       the curve as a picture, at the end
search.json     a search by generations, between two of them
"""

import fcntl
import itertools
import logging
import os
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TypeVar

from pydantic import ValidationError

from rover_ncp.circuit.policy import Policy
from rover_ncp.circuit.policy_file import policy_to_yaml
from rover_ncp.core.config import StrictModel, dump_yaml, load_yaml
from rover_ncp.core.console import printable
from rover_ncp.core.errors import FileError, UsageError
from rover_ncp.core.files import read_text, write_atomic
from sim.learn.settings import Record, Settings, Task

_LOGGER = logging.getLogger(__name__)
_RUNS = Path("runs")
_RECORD = "settings.yaml"
_LEFTOVER = re.compile(r"\.\w+\.(yaml|csv|png|json)\.\w+")
"""Temporary files that ``write_atomic`` leaves when a run is killed while it writes."""

StateT = TypeVar("StateT", bound=StrictModel)


def new_run_path() -> Path:
    """Make and return a folder for a run that was given none: ``runs/train-1``, ``runs/train-2``, ..."""
    for number in itertools.count(1):
        path = _RUNS / f"train-{number}"
        try:
            path.mkdir(parents=True)
            break
        except FileExistsError:
            continue
        except OSError as error:
            raise FileError(
                f"{path}: cannot be made: {error.strerror}; choose a folder with --out"
            ) from error
    return path


def read_record(path: Path) -> Record:
    """Return the record of the run in a folder. Raises UsageError (no run), FileError, ConfigError."""
    if not (path / _RECORD).exists():
        raise UsageError(f"{path}: holds no training run to resume; begin one without --resume")
    return load_yaml(path / _RECORD, Record)


class RunFolder:
    """The folder of one run, open while this process holds its lock; made by ``open_run``."""

    def __init__(self, path: Path, record: Record) -> None:
        self.path, self.record = path, record
        self.policy_path = path / "policy.yaml"

    def write(self, name: str, content: str | bytes | StrictModel | Policy) -> None:
        """Write a file. Raises FileError, also if the folder was moved: a new one would lack its settings."""
        if not (self.path / _RECORD).is_file():
            problem = "was moved or removed during the training; go on with --resume where it is"
            raise FileError(f"{self.path}: {problem}")
        if isinstance(content, StrictModel):
            content = content.model_dump_json()
        elif isinstance(content, Policy):
            content = policy_to_yaml(content)
        write_atomic(self.path / name, content)

    def read(self, name: str, kind: type[StateT]) -> StateT | None:
        """Return the state in a file, None without such a file. Raises FileError for a damaged one."""
        path = self.path / name
        try:
            return kind.model_validate_json(read_text(path)) if path.is_file() else None
        except ValidationError as error:
            raise FileError(f"{path}: not a state of this version; delete it to begin it again") from error


@contextmanager
def open_run(path: Path, settings: Settings, task: Task, resume: bool) -> Iterator[RunFolder]:
    """Begin a run in an empty or missing folder or, if ``resume``, go on with the one it holds.

    The folder has the record that the run began with. Raises UsageError or ConfigError if the folder holds
    something else, nothing to resume, or a run of other settings or files. Other versions are logged as a
    warning. A folder whose run was killed before it wrote anything counts as empty.
    """
    record, saved = Record.of(settings, task), path / _RECORD
    try:
        path.mkdir(parents=True, exist_ok=True)
        handle = os.open(path, os.O_RDONLY | os.O_DIRECTORY)
    except OSError as error:
        raise FileError(f"{path}: cannot be used as a folder: {error.strerror}") from error
    try:
        # Nothing but this process holds the lock: workers do not inherit it, a kill releases it.
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise UsageError(f"{path}: another process is training in this folder") from error
        if resume:
            began = read_record(path)
            began.require_same(record, str(saved))
            if others := set(began.made_with.items()) - set(record.made_with.items()):
                versions = printable(", ".join(" ".join(each) for each in sorted(others)))
                _LOGGER.warning("%s: the run began with %s; its result will mix versions", path, versions)
            record = began
        elif saved.exists():
            raise UsageError(f"{path}: holds a training run; go on with --resume, or choose another --out")
        elif foreign := [each.name for each in path.iterdir() if not _LEFTOVER.fullmatch(each.name)]:
            raise UsageError(f"{path}: is not empty ({min(foreign)}) and holds no training run")
        for file in (*path.glob(".*"), *path.glob("agents/.*")):
            if _LEFTOVER.fullmatch(file.name):
                file.unlink(missing_ok=True)
        if not resume:
            write_atomic(saved, dump_yaml(record.model_dump()))
        yield RunFolder(path, record)
    finally:
        os.close(handle)
