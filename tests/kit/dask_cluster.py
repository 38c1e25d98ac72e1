"""A Dask scheduler on loopback with worker processes, for tests."""

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

# Without git on the path no record names a commit. A commit could be made while the tests run.
ENVIRONMENT = {**os.environ, "PATH": ""}
FREE_PORT = "tcp://127.0.0.1:0"


def wait_for(condition: Callable[[], bool], what: str, timeout_s: float = 60.0) -> None:
    deadline = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < deadline, f"waited {timeout_s} s for {what}"
        time.sleep(0.02)


def start(*arguments: str) -> subprocess.Popen[bytes]:
    return subprocess.Popen(
        [sys.executable, *arguments],
        env=ENVIRONMENT,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )


def start_worker(scheduler: Path) -> subprocess.Popen[bytes]:
    return start(
        "-m",
        "distributed.cli.dask_worker",
        "--scheduler-file",
        str(scheduler),
        "--nthreads",
        "1",
        "--no-nanny",
        "--no-dashboard",
        "--host",
        "127.0.0.1",
    )


class Cluster:
    """A scheduler on loopback with two workers."""

    def __init__(self, folder: Path) -> None:
        self.file = folder / "scheduler.json"
        self.processes = [
            start(
                "-m",
                "distributed.cli.dask_scheduler",
                "--host",
                FREE_PORT,
                "--no-dashboard",
                "--scheduler-file",
                str(self.file),
                "--no-show",
            )
        ]
        wait_for(self._written, "the scheduler")
        self.address = json.loads(self.file.read_text())["address"]

    def _written(self) -> bool:
        try:
            return "address" in json.loads(self.file.read_text())
        except (FileNotFoundError, json.JSONDecodeError):
            return False

    def add_worker(self) -> subprocess.Popen[bytes]:
        self.processes.append(start_worker(self.file))
        return self.processes[-1]

    def stop(self) -> None:
        for process in reversed(self.processes):
            process.kill()
            process.wait()
