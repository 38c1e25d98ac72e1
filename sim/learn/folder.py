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
import hashlib
import json
import logging
import os
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Generic

import numpy as np
from pydantic import BaseModel

from rover_ncp.circuit.policy import Policy
from rover_ncp.circuit.policy_file import policy_to_yaml
from rover_ncp.core.config import dump_yaml, load_yaml
from rover_ncp.core.console import printable
from rover_ncp.core.errors import FileError, UsageError
from rover_ncp.core.files import read_text, write_atomic
from sim.learn.settings import Record, RobustSettings, Settings, SettingsT, TrainSettings

_LOGGER = logging.getLogger(__name__)
_RUNS = Path("runs")
_RECORD = "settings.yaml"
_LEFTOVER = re.compile(r"\.(settings|policy|curve|search|\d+)\.(yaml|csv|png|json)\.\w+")
"""Temporary files that ``write_atomic`` leaves when a run is killed while it writes."""


def new_run_path() -> Path:
    """Make and return a folder for a run that was given none: ``runs/train-1``, ``runs/train-2``, ..."""
    number = 1
    while True:
        path = _RUNS / f"train-{number}"
        try:
            path.mkdir(parents=True)
        except FileExistsError:
            number += 1
        except OSError as error:
            raise FileError(
                f"{path}: cannot be made: {error.strerror}; choose a folder with --out"
            ) from error
        else:
            return path


class _Kind(BaseModel):
    settings: dict[str, Any]


def saved_settings(path: Path) -> Settings:
    """Return the settings of the run in a folder. Raises UsageError (none), FileError, ConfigError."""
    saved = path / _RECORD
    if not saved.exists():
        raise _nothing_to_resume(path)
    kind = load_yaml(saved, _Kind).settings
    if "randomize" in kind:
        return load_yaml(saved, Record[RobustSettings]).settings
    return load_yaml(saved, Record[TrainSettings]).settings


class RunFolder(Generic[SettingsT]):
    """The folder of one run, open while this process holds its lock; made by ``open_run``."""

    def __init__(self, path: Path, record: Record[SettingsT]) -> None:
        self.path = path
        self.record: Record[SettingsT] = record
        self._settings = dump_yaml(record.settings.model_dump())
        self.policy_path = path / "policy.yaml"

    def write(self, name: str, content: str | bytes | Policy) -> None:
        """Write a file. Raises FileError, also if the folder was moved: a new one would lack its settings."""
        if not (self.path / _RECORD).is_file():
            problem = "was moved or removed during the training; go on with --resume where it is"
            raise FileError(f"{self.path}: {problem}")
        text = policy_to_yaml(content) if isinstance(content, Policy) else content
        write_atomic(self.path / name, text)

    def write_state(self, name: str, state: Mapping[str, Any]) -> None:
        """Write what resuming needs, with a digest of it and of the run's settings."""
        self.write(name, dump_checked(state, f"{self._settings}{name}"))

    def read_state(self, name: str) -> dict[str, Any] | None:
        """Return what ``write_state`` wrote, None without such a file. Raises FileError for another file."""
        path = self.path / name
        return load_checked(path, f"{self._settings}{name}") if path.is_file() else None


def dump_checked(state: Mapping[str, Any], owner: str) -> str:
    """Return a state as a line of JSON, with a digest of it and of ``owner``, a text that names its run."""
    text = _text(state)
    return f'{{"sha256": "{_digest(owner, text)}", "state": {text}}}\n'


def load_checked(path: Path, owner: str) -> dict[str, Any]:
    """Return a state that ``dump_checked`` made. Raises FileError for a damaged file, or of another owner."""
    try:
        data = json.loads(read_text(path))
        state: dict[str, Any] = data["state"]
        if data["sha256"] == _digest(owner, _text(state)):
            return state
    except (ValueError, KeyError, TypeError, RecursionError):
        pass
    raise FileError(f"{path}: damaged, or not of this run; delete it to begin it again")


def _text(state: Mapping[str, Any]) -> str:
    """Return a state as JSON, arrays as nested lists; it keeps every bit."""
    return json.dumps(state, allow_nan=False, default=np.ndarray.tolist)


def _digest(owner: str, text: str) -> str:
    return hashlib.sha256(f"{owner}\n{text}".encode()).hexdigest()


@contextmanager
def open_run(path: Path, record: Record[SettingsT], resume: bool) -> Iterator[RunFolder[SettingsT]]:
    """Begin a run in an empty or missing folder or, if ``resume``, go on with the one it holds.

    The folder has the record that the run began with. Raises UsageError or ConfigError if the folder holds
    something else, nothing to resume, or a run of other settings or files. Other versions are logged as a
    warning. A folder whose run was killed before it wrote anything counts as empty.
    """
    saved = path / _RECORD
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
        if saved.exists():
            if not resume:
                raise UsageError(
                    f"{path}: holds a training run; go on with --resume, or choose another --out"
                )
            began = load_yaml(saved, type(record))
            began.require_same(record, str(saved))
            if versions := began.other_versions(record):
                warning = f"{path}: the run began with {versions}; its result will mix both"
                _LOGGER.warning("%s", printable(warning))
            record = began
        elif resume:
            raise _nothing_to_resume(path)
        elif foreign := [each.name for each in path.iterdir() if not _LEFTOVER.fullmatch(each.name)]:
            raise UsageError(f"{path}: is not empty ({min(foreign)}) and holds no training run")
        for file in (*path.glob(".*"), *path.glob("agents/.*")):
            if _LEFTOVER.fullmatch(file.name):
                file.unlink(missing_ok=True)
        write_atomic(saved, dump_yaml(record.model_dump()))
        yield RunFolder(path, record)
    finally:
        os.close(handle)


def _nothing_to_resume(path: Path) -> UsageError:
    return UsageError(f"{path}: holds no training run to resume; begin one without --resume")
