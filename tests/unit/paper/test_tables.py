"""The paper's tables, made of stored runs."""

import json
from pathlib import Path

import numpy as np
import pytest

from rover_ncp.cli import run
from sim.paper.cell import Cell, Name, Shelf
from sim.paper.curves import curves_png
from sim.paper.grid import GRID, status
from sim.paper.packed import pack
from sim.paper.published import Reported
from sim.paper.tables import Table, Verdict, parameters, table, verdict
from sim.paper.tasks import TASKS
from sim.paper.train import BudgetName, replay, train_cell


def cell(task, agent, seed, mean, success=True):
    return Cell(
        name=Name(task=task, agent=agent, seed=seed),
        command="",
        budget="default",
        settings={},
        made_with={},
        wall_s=2.0,
        cpu_s=1.0,
        evaluations=3,
        steps=100,
        ended="steps",
        curve=((10, 0.0), (50, mean)),
        episodes=1,
        mean=mean,
        std=0.0,
        plain_mean=mean,
        success=success,
        parameters=pack(np.zeros(3)),
    )


@pytest.fixture
def shelf(tmp_path):
    shelf = Shelf(tmp_path, None)
    for seed, mean in enumerate((97.0, 98.0, 99.0)):
        shelf.save(cell("mountain-car", "circuit", seed, mean))
    shelf.save(cell("mountain-car", "random", 0, 0.0, success=False))
    return shelf


def test_a_cell_holds_mean_spread_success_and_the_papers(shelf):
    found = {(one.task, one.agent): one for one in table(Table.RANDOM, shelf)}
    circuit, wiring = found["mountain-car", "circuit"], found["mountain-car", "random"]
    assert (circuit.mean, circuit.std, circuit.runs, circuit.wanted) == (98.0, 1.0, 3, 10)
    assert circuit.published == Reported(91.5, 6.6, 0.8)
    assert circuit.verdict is Verdict.BETTER
    assert (wiring.mean, wiring.std, wiring.success_rate, wiring.verdict) == (0.0, None, 0.0, None)
    assert found["half-cheetah", "circuit"].mean is None


def test_the_verdict_is_welchs_test():
    # From the textbook: t = (20.6 - 22.1) / sqrt(3.0 / 10 + 6.5 / 10), 15.9 degrees of freedom.
    judged, p = verdict(20.6, 3.0**0.5, 10, Reported(22.1, 6.5**0.5))
    assert judged is Verdict.EQUAL
    assert p == pytest.approx(0.143, abs=0.002)
    assert verdict(20.0, 1.0, 10, Reported(22.1, 1.0))[0] is Verdict.WORSE
    assert verdict(1200.0, 0.0, 10, Reported(1168.5, 21.7))[0] is Verdict.BETTER
    assert verdict(1.0, 0.0, 10, Reported(1.0, 0.0))[0] is Verdict.EQUAL


def test_coverage_counts_the_grids_runs_only(shelf):
    shelf.save(cell("mountain-car", "mlp", 77, 1.0))
    made = {(group.task, group.agent): count for group, count in status(shelf)}
    assert (made["mountain-car", "circuit"], made["mountain-car", "mlp"]) == (3, 0)
    assert all(group.runs >= (10 if group.agent == "circuit" else 5) for group in GRID)
    assert {group.task for group in GRID} == set(TASKS)


def test_parameters_are_the_papers():
    rows = {row["task"]: row for row in parameters()}
    pendulum = rows["pendulum"]
    assert [pendulum[key] for key in ("iterations", "horizon", "rollouts", "worst")] == [25_000, 1000, 20, 10]
    assert pendulum["sensors"]["angle"] == {"PLM": 0.12, "AVM": -0.12}
    assert pendulum["motors"]["action"] == {"FWD": 0.3, "REV": -0.3}
    assert (rows["parking"]["neurons"], rows["parking"]["synapses"]) == (12, 30)
    assert rows["half-cheetah"]["parameters"] == 87 + 17 * 2 + 2 * 6


def test_curves_are_a_picture(shelf):
    assert curves_png(shelf).startswith(b"\x89PNG")


@pytest.mark.parametrize("what", ["status", "table1", "table2", "table3", "parameters"])
def test_each_table_is_json_or_text(what, shelf, capsys):
    assert run(["paper", what, "--runs", str(shelf.own), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)
    assert run(["paper", what, "--runs", str(shelf.own)]) == 0
    assert "mountain-car" in capsys.readouterr().out.lower().replace(" ", "-")


@pytest.mark.parametrize("what", ["time-constants", "contributions"])
def test_what_a_trained_parking_circuit_is_like_inside(what, tmp_path, capsys):
    shelf = Shelf(tmp_path, None)
    trained = train_cell(Name(task="parking", agent="circuit", seed=0), BudgetName.QUICK)
    shelf.save(trained.model_copy(update={"success": True, "mean": 0.0}))
    assert run(["paper", what, "--runs", str(tmp_path), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    rows = found["time_constants_s" if what == "time-constants" else "contributions"]
    assert found["runs"] >= 1
    assert len(rows) == 8
    assert all(row["published"] for row in rows)


def test_shipped_runs_replay():
    shelf = Shelf(Path("nowhere"))
    for task in TASKS:
        for stored in shelf.cells(task, "circuit")[:1]:
            again = replay(stored)
            assert {field: getattr(stored, field) for field in again} == again, stored.name
