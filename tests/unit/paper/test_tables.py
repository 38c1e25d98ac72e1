"""The paper's tables, from stored runs."""

import json
from dataclasses import replace

import numpy as np
import pytest

from rover_ncp.cli import run
from sim.paper import BudgetName, curves, runs
from sim.paper.curves import curves_png
from sim.paper.results import SHIPPED, Packed, Result, ResultStore, RunName
from sim.paper.runs import agrees, train_run
from sim.paper.selection import coverage, grid
from sim.paper.statistics import Summary, welch
from sim.paper.tables import TABLES, Published, Verdict, corrected, parameters, table
from sim.paper.tasks import TASKS


def result(task, agent, seed, mean, success=True, budget=BudgetName.DEFAULT):
    return Result(
        name=RunName(task=task, agent=agent, seed=seed, budget=budget),
        command="",
        budget=budget,
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
        parameters=Packed.of(np.zeros(3)),
    )


@pytest.fixture
def store(tmp_path):
    store = ResultStore(tmp_path, None)
    for seed, mean in enumerate((97.0, 98.0, 99.0)):
        store.save(result("mountain-car", "circuit", seed, mean))
    store.save(result("mountain-car", "random", 0, 0.0, success=False))
    return store


def test_a_row_holds_mean_spread_success_and_the_papers(store):
    found = {(row.task, row.agent): row for row in table("random-circuits", store)}
    circuit, wiring = found["mountain-car", "circuit"], found["mountain-car", "random"]
    assert (circuit.mean, circuit.std, circuit.runs, circuit.wanted) == (98.0, 1.0, 3, 10)
    assert circuit.published == Published(91.5, 6.6, 0.8)
    assert circuit.verdict is Verdict.BETTER
    assert (wiring.mean, wiring.std, wiring.success_rate, wiring.verdict) == (0.0, None, 0.0, None)
    assert found["half-cheetah", "circuit"].mean is None


def test_the_verdict_is_welchs_test():
    # From the textbook: t = (20.6 - 22.1) / sqrt(3.0 / 10 + 6.5 / 10), 15.9 degrees of freedom.
    found = welch(Summary(20.6, 3.0**0.5, 10), Summary(22.1, 6.5**0.5, 10))
    assert found.p == pytest.approx(0.143, abs=0.002)
    # 2.121 is the quantile of 15.9 degrees of freedom.
    assert found.interval == pytest.approx((-1.5 - 2.121 * 0.95**0.5, -1.5 + 2.121 * 0.95**0.5), abs=0.002)
    assert welch(Summary(1.0, 0.0, 10), Summary(1.0, 0.0, 10)).p == 1.0
    assert welch(Summary(1.1, 0.0, 10), Summary(1.0, 0.0, 10)).p == 0.0


def test_the_verdict_rests_on_p_corrected_for_the_values_of_a_table(store):
    # Each p alone is 0.03 to 0.04; with two values the smaller p is doubled.
    for seed, mean in enumerate((95.0, 96.5, 98.0)):
        store.save(result("mountain-car", "mlp", seed, mean))
    alone = {row.agent: row for row in table("networks", store) if row.task == "mountain-car"}
    assert alone["circuit"].verdict is Verdict.BETTER
    means = {"circuit": 96.67, "mlp": 97.35}
    rows = corrected(replace(alone[agent], mean=mean, std=0.1) for agent, mean in means.items())
    assert [row.welch.p < 0.05 <= row.p_holm for row in rows] == [True, True]
    assert {row.verdict for row in rows} == {Verdict.EQUAL}


def test_coverage_counts_the_grids_runs_only(store):
    store.save(result("mountain-car", "mlp", 77, 1.0))
    made = {(row["task"], row["agent"]): row["made"] for row in coverage(store)}
    assert (made["mountain-car", "circuit"], made["mountain-car", "mlp"]) == (3, 0)
    assert {group.task for group in grid()} == set(TASKS)


def test_two_of_the_papers_tables_differ_on_the_same_experiment(store):
    found = {
        which: {row.task: row.published for row in table(which, store) if row.agent == "circuit"}
        for which in TABLES
    }
    assert found["random-circuits"]["pendulum"].mean == 866.4
    assert (
        found["policy-gradients"]["pendulum"] == found["networks"]["pendulum"] == Published(1168.5, 21.7, 0.9)
    )


@pytest.mark.parametrize("which", TABLES)
def test_a_table_of_the_papers_own_search_holds_its_circuits(which, store):
    store.save(result("mountain-car", "circuit", 0, 92.0, budget=BudgetName.PUBLISHED))
    found = {(row.task, row.agent): row.mean for row in table(which, store, BudgetName.PUBLISHED)}
    assert found["mountain-car", "circuit"] == 92.0
    assert ("cart-pole", "circuit") in found or which == "policy-gradients"


def test_parameters_are_the_papers():
    rows = {row["task"]: row for row in parameters()}
    pendulum = rows["pendulum"]
    assert [pendulum[key] for key in ("iterations", "horizon", "rollouts", "worst")] == [25_000, 1000, 20, 10]
    assert pendulum["sensors"]["angle"] == {"PLM": 0.12, "AVM": -0.12}
    assert pendulum["motors"]["action"] == {"FWD": 0.3, "REV": -0.3}
    assert (rows["parking"]["neurons"], rows["parking"]["synapses"]) == (12, 30)
    assert rows["half-cheetah"]["parameters"] == 87 + 17 * 2 + 2 * 6


def test_curves_are_a_picture(store):
    assert curves_png(store).startswith(b"\x89PNG")
    assert curves_png(store, BudgetName.PUBLISHED).startswith(b"\x89PNG")


@pytest.mark.parametrize("kind", curves._KINDS)
def test_a_curve_holds_all_runs_also_one_that_its_start_solved(kind):
    lines = []

    class Axes:
        def fill_between(self, *_, **__): ...

        def plot(self, steps, middle, label, **_):
            lines.append((middle, label))

    drawn = [result("cart-pole", "circuit", 0, 97.0), result("cart-pole", "circuit", 1, 99.0)]
    drawn[1] = drawn[1].model_copy(update={"curve": ((10, 99.0),)})
    curves._draw(Axes(), drawn, "circuit", kind)
    [(middle, label)] = lines
    assert (middle[0], middle[-1], label) == (49.5, 98.0, "circuit (2)")


@pytest.mark.parametrize("what", ["status", *TABLES, "parameters"])
def test_each_table_is_json_or_text(what, store, capsys):
    runs = [] if what == "parameters" else ["--runs", str(store.own)]
    assert run(["paper", what, *runs, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)
    assert run(["paper", what, *runs]) == 0
    assert "mountain-car" in capsys.readouterr().out.lower().replace(" ", "-")


@pytest.mark.long
def test_trained_parking_circuits_are_interpreted(tmp_path, capsys):
    name = RunName(task="parking", agent="circuit", seed=0)
    trained = train_run(name.model_copy(update={"budget": BudgetName.QUICK}))
    ResultStore(tmp_path).save(trained.model_copy(update={"name": name, "success": True, "mean": 0.0}))
    for what, key in (("time-constants", "time_constants_s"), ("contributions", "contributions")):
        assert run(["paper", what, "--runs", str(tmp_path), "--json"]) == 0
        found = json.loads(capsys.readouterr().out)
        assert found["runs"] >= 1
        assert len(found[key]) == 8
        assert all(row["published"] for row in found[key])


def test_a_replay_without_options_scores_all_shipped_runs(tmp_path, monkeypatch, capsys):
    scored = ("episodes", "mean", "std", "plain_mean", "success")
    monkeypatch.setattr(runs, "replay", lambda stored, _: {name: getattr(stored, name) for name in scored})
    shipped = len(list(SHIPPED.rglob("*.json")))
    assert run(["paper", "replay", "--runs", str(tmp_path), "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == {"replayed": shipped, "exact": shipped, "differ": []}


def test_a_replay_may_differ_by_a_billionth_but_not_in_its_verdict():
    stored = result("mountain-car", "circuit", 0, 97.0)
    score = {"episodes": 1, "mean": 97.0, "std": 0.0, "plain_mean": 97.0, "success": True}
    assert agrees(stored, score | {"mean": 97.0 + 1e-8})
    assert not agrees(stored, score | {"mean": 97.0 + 1e-6})
    assert not agrees(stored, score | {"success": False})
    cheetah = result("half-cheetah", "circuit", 0, 3000.0)
    assert agrees(cheetah, score)
    assert not agrees(cheetah, score | {"success": False})
