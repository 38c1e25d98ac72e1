"""A training run on disk. Every file is written whole or not at all, so a run may be killed at any moment.

settings.yaml   the record, written first
policy.yaml     the best agent's policy
curve.csv       each agent's best return so far, see ``curve.py``
curve.png       the same as a picture, at the end
agents/NN.json  an agent between two iterations: all that resuming needs
agents/NN.yaml  its policy, at the end
"""

import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel

from rover_ncp.circuit.policy import Policy
from rover_ncp.circuit.policy_file import save_policy
from rover_ncp.core.config import dump_yaml, load_yaml
from rover_ncp.core.errors import FileError, UsageError
from rover_ncp.core.files import write_atomic
from sim.learn.agent_file import load_agent, save_agent
from sim.learn.agents import AgentState, Plan, Snapshot
from sim.learn.curve import curve_csv, curve_png
from sim.learn.record import (
    Record,
    RobustSettings,
    SettingsT,
    Task,
    TaskSettings,
    TrainSettings,
    resolve_task,
)

_RUNS = Path("runs")
_RECORD = "settings.yaml"
# What ``write_atomic`` calls its temporary files, for those a killed run can have been writing.
_TEMPORARY = (
    ".settings.yaml.",
    ".policy.yaml.",
    ".curve.csv.",
    ".curve.png.",
    ".search.json.",
    *(f".{d}" for d in "0123456789"),
)


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


def saved_settings(path: Path) -> TrainSettings | RobustSettings | TaskSettings:
    """Return the settings of the run in a folder. Raises UsageError (none), FileError, ConfigError."""
    saved = path / _RECORD
    if not saved.exists():
        raise _nothing_to_resume(path)
    kind = load_yaml(saved, _Kind).settings
    if "randomize" in kind:
        return load_yaml(saved, Record[RobustSettings]).settings
    if "task" in kind:
        return load_yaml(saved, Record[TaskSettings]).settings
    return load_yaml(saved, Record[TrainSettings]).settings


class RunFolder:
    """The folder of one run, open while this process holds its lock; made by ``open_run``."""

    def __init__(self, path: Path, record: Record[TrainSettings], task: Task) -> None:
        self.path = path
        self.policy_path = path / "policy.yaml"
        self._agents = path / "agents"
        self._record = record
        self.task = task

    def load_agents(self, plan: Plan) -> Snapshot:
        """Read the agents as they were saved last; one without a file has not begun. Raises FileError."""
        agents = []
        for number in range(self._record.settings.agents):
            path = self._agents / f"{number:02}.json"
            agents.append(load_agent(path, number, plan) if path.is_file() else AgentState(number))
        return Snapshot(tuple(agents))

    def save_progress(self, snapshot: Snapshot) -> None:
        """Write the agents, the best policy and the table of the curves. Raises FileError."""
        require_run(self.path)
        for agent in snapshot.agents:
            save_agent(self._agents / f"{agent.number:02}.json", agent)
        save_policy(self.policy_path, self.policy(snapshot.best, snapshot))
        write_atomic(self.path / "curve.csv", curve_csv(snapshot.agents, snapshot.iterations))

    def finish(self, snapshot: Snapshot) -> None:
        """Write everything, with each agent's policy and the picture. Raises FileError."""
        self.save_progress(snapshot)
        for agent in snapshot.agents:
            save_policy(self._agents / f"{agent.number:02}.yaml", self.policy(agent, snapshot))
        settings = self._record.settings
        title = f"{self.task.course.name}, {settings.search} search, seed {settings.seed}"
        write_atomic(self.path / "curve.png", curve_png(snapshot.agents, snapshot.iterations, title))

    def policy(self, agent: AgentState, snapshot: Snapshot) -> Policy:
        """Return an agent's incumbent as a policy with its provenance."""
        if agent.search is None:
            raise ValueError(f"agent {agent.number} has not begun")
        provenance = self._record.provenance(
            snapshot.iterations, **{"agent": agent.number, "return": agent.value}
        )
        policy = self.task.policy.with_parameters(np.array(agent.search["incumbent"]))
        return replace(policy, provenance=provenance)


@contextmanager
def open_run(path: Path, settings: TrainSettings, resume: bool) -> Iterator[RunFolder]:
    """Begin a run, or go on with one, as ``open_folder`` does."""
    task = resolve_task(settings)
    with open_folder(path, Record[TrainSettings].of(settings, task.policy, task.course), resume) as record:
        yield RunFolder(path, record, task)


@contextmanager
def open_folder(path: Path, record: Record[SettingsT], resume: bool) -> Iterator[Record[SettingsT]]:
    """Begin a run in an empty or missing folder or, if ``resume``, go on with the one it holds.

    Gives the record that the run began with. Raises UsageError or ConfigError if the folder holds something
    else, nothing to resume, or a run of other settings. A folder whose run was killed before it wrote
    anything counts as empty.
    """
    saved = path / _RECORD
    try:
        path.mkdir(parents=True, exist_ok=True)
        handle = os.open(path, os.O_RDONLY | os.O_DIRECTORY)
    except OSError as error:
        raise FileError(f"{path}: cannot be used as a folder: {error.strerror}") from error
    try:
        # Nothing but this process holds the lock: workers do not inherit it, a kill releases it.
        _lock(handle, path)
        if saved.exists():
            if not resume:
                raise UsageError(
                    f"{path}: holds a training run; go on with --resume, or choose another --out"
                )
            began = load_yaml(saved, type(record))
            began.require_same(record, str(saved))
            record = began
        elif resume:
            raise _nothing_to_resume(path)
        elif foreign := [name for name in os.listdir(path) if not _is_leftover(name)]:  # noqa: PTH208
            raise UsageError(f"{path}: is not empty ({min(foreign)}) and holds no training run")
        _sweep(path)
        write_atomic(saved, dump_yaml(record.model_dump()))
        yield record
    finally:
        os.close(handle)


def require_run(path: Path) -> None:
    """Raise FileError if the folder of a run was moved or removed: a new one would lack its settings."""
    if not (path / _RECORD).is_file():
        raise FileError(f"{path}: was moved or removed during the training; go on with --resume where it is")


def _nothing_to_resume(path: Path) -> UsageError:
    return UsageError(f"{path}: holds no training run to resume; begin one without --resume")


def _lock(handle: int, path: Path) -> None:
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        raise UsageError(f"{path}: another process is training in this folder") from error


def _is_leftover(name: str) -> bool:
    """Whether a killed run may have left this behind: the temporary file of something it was writing."""
    return name.startswith(_TEMPORARY)


def _sweep(path: Path) -> None:
    for folder in (path, path / "agents"):
        for file in folder.glob(".*"):
            if _is_leftover(file.name):
                file.unlink(missing_ok=True)
