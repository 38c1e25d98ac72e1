"""Stored runs: one line each, the last one of a name counts, and they replay."""

import json

import pytest
from kit.paper_runs import result
from kit.paths import ROOT

from rover_ncp.cli import run
from rover_ncp.core.errors import FileError
from sim.paper import BudgetName
from sim.paper.results import ResultStore
from sim.paper.runs import agrees

RESULTS = ROOT / "results"
STORED = [
    run
    for path in sorted(RESULTS.glob("*/*.jsonl"))
    for agent in ("circuit", "ppo", "a2c")
    for run in ResultStore(RESULTS).results(path.stem, agent, BudgetName(path.parent.name))[:1]
]


def test_last_line_of_a_name_counts(tmp_path):
    store = ResultStore(tmp_path)
    for mean in (1.0, 2.0):
        store.save(result("cart-pole", "mlp", 3, mean))
    store.save(result("cart-pole", "mlp", 1, 5.0))
    store.save(result("cart-pole", "mlp-wide", 1, 6.0))
    assert [run.mean for run in store.results("cart-pole", "mlp")] == [5.0, 2.0]
    assert store.results("cart-pole", "mlp", BudgetName.ALGORITHM1) == []
    assert len(list(store.every())) == 3
    again = ResultStore(tmp_path)
    assert again.find(result("cart-pole", "mlp", 3, 0.0).name) == result("cart-pole", "mlp", 3, 2.0)


def test_line_of_an_older_version_is_read(tmp_path):
    store, saved = ResultStore(tmp_path), result("parking", "circuit", 0, -0.05)
    settings = {"rollouts": 1, "evaluations": 20_000, "starts": 1, "warm_up": 0, "prunes": False}
    store.save(saved.model_copy(update={"settings": settings}))
    path = store.path("parking", BudgetName.PUBLISHED)
    path.write_text(json.dumps(json.loads(path.read_text()) | {"ended": "evaluations"}) + "\n")
    assert ResultStore(tmp_path).find(saved.name).settings == settings


def test_damaged_line_is_named(tmp_path):
    store = ResultStore(tmp_path)
    saved = result("cart-pole", "mlp", 0, 1.0)
    store.save(saved)
    path = store.path("cart-pole", BudgetName.PUBLISHED)
    path.write_text(path.read_text() + '{"name": ')
    with pytest.raises(FileError, match="line 2"):
        ResultStore(tmp_path).find(saved.name)


def test_values_come_from_complete_curves():
    found = result("cart-pole", "mlp", 0, 480.0, curve=((0, 10, 20.0), (7, 90, 480.0)))
    assert [found.value_after(count) for count in (0, 6, 7)] == [20.0, 20.0, 480.0]
    assert found.model_copy(update={"thinned": True}).value_after(7) is None
    assert found.model_copy(update={"curve": ((None, 10, 20.0),)}).value_after(9) is None


def test_replay_may_differ_by_a_billionth_but_not_in_its_verdict():
    stored = result("mountain-car", "circuit", 0, 97.0)
    for changed, same in (
        ({"mean": 97.0 + 1e-8}, True),
        ({"mean": 97.0 + 1e-6}, False),
        ({"success": False}, False),
    ):
        assert agrees(stored, stored.score.model_copy(update=changed)) is same


@pytest.mark.parametrize("stored", STORED, ids=lambda stored: str(stored.name))
@pytest.mark.long
def test_shipped_run_of_each_budget_and_task_replays(stored):
    name = stored.name
    selected = ["--task", name.task, "--agent", name.agent, "--seed", str(name.seed), "--budget", name.budget]
    assert run(["paper", "replay", *selected, "--results", str(RESULTS)]) == 0
