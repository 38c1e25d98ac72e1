"""Processes that train: commands whose records name no commit, and a Dask cluster on loopback."""

import json
import os
import subprocess
import sys
from pathlib import Path

from sim.park.live import wait_for

# Without git on the path no record names a commit. A commit could be made while the tests run.
ENVIRONMENT = {**os.environ, "PATH": ""}
FREE_PORT = "tcp://127.0.0.1:0"


def start(*arguments, output=subprocess.DEVNULL):
    return subprocess.Popen(
        [sys.executable, *arguments],
        env=ENVIRONMENT,
        text=True,
        stdout=output,
        stderr=output,
        start_new_session=True,
    )


def start_rover_ncp(*arguments, output=subprocess.DEVNULL):
    return start("-m", "rover_ncp", *arguments, output=output)


def is_running(pid):
    """Whether a process has not ended; one that nobody waited for yet has."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except (FileNotFoundError, ProcessLookupError):
        return False


class Cluster:
    """A scheduler on loopback, and the workers that are added."""

    def __init__(self, folder):
        self.file = folder / "scheduler.json"
        options = f"-m distributed.cli.dask_scheduler --host {FREE_PORT} --no-dashboard --no-show"
        self.processes = [start(*options.split(), "--scheduler-file", str(self.file))]
        wait_for(self._written, 60.0, "the scheduler")
        self.address = json.loads(self.file.read_text())["address"]

    def _written(self):
        try:
            return "address" in json.loads(self.file.read_text())
        except (FileNotFoundError, json.JSONDecodeError):
            return False

    def add_worker(self):
        options = "-m distributed.cli.dask_worker --nthreads 1 --no-nanny --no-dashboard --host 127.0.0.1"
        self.processes.append(start(*options.split(), "--scheduler-file", str(self.file)))
        return self.processes[-1]

    def stop(self):
        for process in reversed(self.processes):
            process.kill()
            process.wait()
