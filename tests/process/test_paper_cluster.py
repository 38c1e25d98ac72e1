"""Runs of the paper's grid on a Dask cluster: a real scheduler and two worker processes."""

import json

import pytest
from kit.dask_cluster import Cluster

from rover_ncp.cli import run
from sim.paper import BudgetName
from sim.paper.results import ResultStore

pytestmark = pytest.mark.usefixtures("no_git")

QUICK = ["paper", "run", "--task", "cart-pole", "--agent", "mlp", "--budget", "quick", "--again"]
TIMES = {"wall_s", "cpu_s"}


@pytest.fixture
def cluster(tmp_path):
    found = Cluster(tmp_path)
    yield found
    found.stop()


@pytest.mark.long
def test_a_cluster_makes_the_runs_of_one_machine(cluster, tmp_path, capsys):
    here, there = tmp_path / "here", tmp_path / "there"
    seeds = [f"--seed={seed}" for seed in range(3)]
    # First here, so that the workers find all kernels compiled.
    assert run([*QUICK, *seeds, "--results", str(here), "--processes", "1"]) == 0
    for _ in range(2):
        cluster.add_worker()
    capsys.readouterr()
    assert run([*QUICK, *seeds, "--results", str(there), "--cluster", cluster.address, "--json"]) == 0
    made = json.loads(capsys.readouterr().out)["made"]
    assert sorted(row["seed"] for row in made) == [0, 1, 2]
    results = [ResultStore(folder).results("cart-pole", "mlp", BudgetName.QUICK) for folder in (here, there)]
    for one, other in zip(*results, strict=True):
        assert one.model_dump(exclude=TIMES) == other.model_dump(exclude=TIMES)
