"""Training on a Dask cluster: a real scheduler and two worker processes; one is killed on the way."""

import signal

import pytest
from kit.paths import DATA, content
from kit.training_processes import Cluster, start_rover_ncp

from rover_ncp.cli import run
from sim.park.live import wait_for

pytestmark = pytest.mark.usefixtures("no_git")

COURSE = DATA / "short_course.yaml"
TRAIN = ["train", "--course", str(COURSE), "--agents", "8", "--seed", "3"]


@pytest.fixture(scope="module")
def cluster(tmp_path_factory):
    found = Cluster(tmp_path_factory.mktemp("cluster"))
    yield found
    found.stop()


def test_without_scheduler_or_workers_it_says_so(cluster, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("sim.learn.workers.CONNECT_S", 0.5)
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
def test_a_cluster_gives_the_bytes_of_one_machine_though_a_worker_is_killed(cluster, tmp_path):
    here, there = tmp_path / "here", tmp_path / "there"
    iterations = ["--iterations", "1000"]
    assert run([*TRAIN, *iterations, "--out", str(here), "--processes", "1"]) == 0
    for _ in range(2):
        victim = cluster.add_worker()
    training = start_rover_ncp(*TRAIN, *iterations, "--out", str(there), "--cluster", cluster.address)
    try:
        wait_for((there / "agents" / "01.json").exists, 60.0, "the first block")
        victim.send_signal(signal.SIGKILL)
        assert not (there / "agents" / "07.json").exists()
        assert training.wait(timeout=60) == 0
    finally:
        training.kill()
        training.wait()
    assert content(there) == content(here)
