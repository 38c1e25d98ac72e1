"""Training on a Dask cluster: a real scheduler and two worker processes; one is killed on the way."""

import json
import signal
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
from dask_cluster import Cluster, start, wait_for
from paths import DATA

from rover_ncp.cli import run

COURSE = DATA / "short_course.yaml"
TRAIN = ["train", "--course", str(COURSE), "--agents", "4", "--seed", "3"]


@pytest.fixture(autouse=True)
def _no_git(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", "")


def start_train(*arguments: str) -> subprocess.Popen[bytes]:
    return start("-c", "from rover_ncp.cli import main; main()", *arguments)


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cluster]:
    found = Cluster(tmp_path_factory.mktemp("cluster"))
    yield found
    found.stop()


def content(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


def progress(folder: Path) -> int:
    """Return how many iterations the first agent has saved."""
    try:
        return int(json.loads((folder / "agents" / "00.json").read_text())["search"]["evaluations"])
    except (FileNotFoundError, json.JSONDecodeError):
        return 0


def test_a_cluster_that_is_not_there_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = ["--out", str(tmp_path / "out")]
    assert run([*TRAIN, *out, "--cluster", "tcp://127.0.0.1:9", "--processes", "2"]) == 2
    assert "do not go together" in capsys.readouterr().err


def test_without_scheduler_or_workers_it_says_so(
    cluster: Cluster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("sim.learn.cluster.CONNECT_S", 0.5)
    for number, (address, message) in enumerate(
        (
            ("tcp://127.0.0.1:9", "no Dask scheduler answers at tcp://127.0.0.1:9"),
            ("nonsense", "no Dask scheduler answers at nonsense"),
            (cluster.address, f"the Dask scheduler at {cluster.address} has no workers"),
        )
    ):
        assert run([*TRAIN, "--out", str(tmp_path / str(number)), "--cluster", address]) == 2
        assert message in capsys.readouterr().err


@pytest.mark.long
def test_a_cluster_gives_the_bytes_of_one_machine_though_a_worker_is_killed(
    cluster: Cluster, tmp_path: Path
) -> None:
    here, there = tmp_path / "here", tmp_path / "there"
    iterations = ["--iterations", "1000"]
    # First here, so that the workers find all kernels compiled.
    assert run([*TRAIN, *iterations, "--out", str(here), "--processes", "1"]) == 0
    for _ in range(2):
        victim = cluster.add_worker()
    training = start_train(*TRAIN, *iterations, "--out", str(there), "--cluster", cluster.address)
    try:
        wait_for(lambda: progress(there) > 0, "the first rounds")
        victim.send_signal(signal.SIGKILL)
        killed_at = progress(there)
        assert training.wait(timeout=60) == 0
    finally:
        training.kill()
        training.wait()
    assert killed_at < 1000
    assert content(there) == content(here)
