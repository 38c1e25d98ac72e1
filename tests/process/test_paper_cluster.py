"""Runs of the paper's grid on a Dask cluster: a real scheduler and two worker processes."""

import json
from collections.abc import Iterator
from pathlib import Path

import pytest
from dask_cluster import Cluster

from rover_ncp.cli import run
from sim.paper import BudgetName
from sim.paper.results import RunName, load_result

QUICK = ["paper", "run", "--task", "cart-pole", "--agent", "mlp", "--budget", "quick", "--again"]
TIMES = {"wall_s", "cpu_s"}


@pytest.fixture(autouse=True)
def _no_git(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", "")


@pytest.fixture
def cluster(tmp_path: Path) -> Iterator[Cluster]:
    found = Cluster(tmp_path)
    yield found
    found.stop()


@pytest.mark.long
def test_a_cluster_makes_the_runs_of_one_machine(
    cluster: Cluster, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    here, there = tmp_path / "here", tmp_path / "there"
    seeds = [f"--seed={seed}" for seed in range(3)]
    # First here, so that the workers find all kernels compiled.
    assert run([*QUICK, *seeds, "--runs", str(here), "--processes", "1"]) == 0
    for _ in range(2):
        cluster.add_worker()
    capsys.readouterr()
    assert run([*QUICK, *seeds, "--runs", str(there), "--cluster", cluster.address, "--json"]) == 0
    made = json.loads(capsys.readouterr().out)["made"]
    assert sorted(row["seed"] for row in made) == [0, 1, 2]
    for seed in range(3):
        name = RunName(task="cart-pole", agent="mlp", seed=seed, budget=BudgetName.QUICK)
        results = [load_result(name.path(folder)).model_dump(exclude=TIMES) for folder in (here, there)]
        assert results[0] == results[1]


def test_conflicting_options_are_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    nowhere = ["--runs", str(tmp_path), "--cluster", "tcp://127.0.0.1:9"]
    assert run([*QUICK, *nowhere, "--processes", "2"]) == 2
    assert "--cluster goes with neither --processes" in capsys.readouterr().err


def test_a_cluster_that_is_not_there_is_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("sim.learn.cluster.CONNECT_S", 0.5)
    assert run([*QUICK, "--runs", str(tmp_path), "--cluster", "tcp://127.0.0.1:9"]) == 2
    assert "no Dask scheduler answers at tcp://127.0.0.1:9" in capsys.readouterr().err
