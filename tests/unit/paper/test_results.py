"""Stored runs: one line each, the last one of a name counts, and they replay."""

import pytest
from kit.paper_runs import result
from kit.paths import ROOT

from paper.runs import agrees, replay
from paper.store import BudgetName, ResultStore

RESULTS = ROOT / "paper" / "results"


def test_last_line_of_a_name_counts(tmp_path):
    store = ResultStore(tmp_path)
    for mean in (1.0, 2.0):
        store.save(result("cart-pole", "mlp", 3, mean))
    store.save(result("cart-pole", "mlp", 1, 5.0))
    store.save(result("cart-pole", "mlp-wide", 1, 6.0))
    assert [run.mean for run in store.results("cart-pole", "mlp")] == [5.0, 2.0]
    assert store.results("cart-pole", "mlp", BudgetName.ALGORITHM1) == []
    assert len(list(store.every())) == 3
    assert ResultStore(tmp_path).results("cart-pole", "mlp")[1] == result("cart-pole", "mlp", 3, 2.0)


def test_run_after_a_line_that_was_cut_off_is_whole(tmp_path):
    store = ResultStore(tmp_path)
    store.save(result("cart-pole", "mlp", 0, 1.0))
    path = store.path("cart-pole", BudgetName.PUBLISHED)
    path.write_text(path.read_text() + '{"name": ')
    store.save(result("cart-pole", "mlp", 1, 2.0))
    lines = path.read_text().splitlines()
    assert [len(lines), lines[1]] == [3, '{"name": ']
    path.write_text(f"{lines[0]}\n{lines[2]}\n")
    assert [run.mean for run in ResultStore(tmp_path).results("cart-pole", "mlp")] == [1.0, 2.0]


def test_replay_may_differ_by_a_billionth_but_not_in_its_verdict():
    stored = result("mountain-car", "circuit", 0, 97.0)
    for changed, same in (
        ({"mean": 97.0 + 1e-8}, True),
        ({"mean": 97.0 + 1e-6}, False),
        ({"success": False}, False),
    ):
        assert agrees(stored, stored.score.model_copy(update=changed)) is same


@pytest.mark.long
@pytest.mark.parametrize("path", sorted(RESULTS.glob("*/*.jsonl")), ids=str)
def test_a_shipped_run_of_each_agent_of_a_budget_and_task_replays(path):
    store, budget = ResultStore(RESULTS), BudgetName(path.parent.name)
    for agent in ("circuit", "ppo", "a2c"):
        for run in store.results(path.stem, agent, budget)[:1]:
            assert agrees(run, replay(run))
