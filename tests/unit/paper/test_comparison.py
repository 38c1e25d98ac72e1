"""Run against run: the test, its correction and the effect size."""

from pathlib import Path

import numpy as np
import pytest
from scipy.stats import mannwhitneyu

from rover_ncp.cli import run
from sim.paper import BudgetName
from sim.paper.comparison import compare_agents
from sim.paper.results import ResultStore
from sim.paper.statistics import fisher, holm, measure


def test_holms_correction_is_that_of_the_textbook():
    # Holm (1979): 0.01, 0.02, 0.03, 0.04 times 4, 3, 2, 1, never falling.
    assert holm([0.01, 0.04, 0.03, 0.02]) == pytest.approx([0.04, 0.06, 0.06, 0.06])
    assert holm([0.4, 0.9]) == pytest.approx([0.8, 0.9])
    assert holm([]) == []


def test_a_permutation_test_of_few_runs_is_exact():
    # 6 against 2 of 8 runs: 28 ways to divide them, of which one each way is as far apart.
    effect = measure(np.arange(10.0, 16.0), np.array([1.0, 2.0]))
    assert effect.p == pytest.approx(2 / 28)
    assert effect.difference == pytest.approx(12.5 - 1.5)
    assert effect.probability == 1.0
    assert effect.interval[0] > 8.0


def test_the_probability_of_superiority_counts_ties_by_half():
    effect = measure(np.array([3.0, 3.0, 5.0]), np.array([3.0, 1.0, 3.0]))
    assert effect.probability == pytest.approx((3 * 1 + 2 * 2 * 0.5 + 2) / 9)
    assert effect.probability == mannwhitneyu([3, 3, 5], [3, 1, 3]).statistic / 9


def test_equal_runs_show_no_difference():
    effect = measure(np.full(10, 1000.0), np.full(5, 1000.0))
    assert (effect.difference, effect.interval, effect.probability, effect.p) == (0.0, (0.0, 0.0), 0.5, 1.0)


def test_p_values_of_equal_distributions_are_uniform():
    rng = np.random.default_rng(0)
    low = sum(measure(rng.normal(size=8), rng.normal(size=8)).p < 0.2 for _ in range(60))
    assert 3 <= low <= 22  # 12 expected


def test_the_interval_of_a_difference_of_rates_is_newcombes():
    # Newcombe (1998), method 10, example (a): 56 of 70 and 48 of 80.
    found = fisher(56, 70, 48, 80)
    assert found.difference == pytest.approx(0.2)
    assert found.interval == pytest.approx((0.0524, 0.3339), abs=5e-5)
    assert found.sentence().startswith(
        "difference 0.200 (0.052 .. 0.334); Fisher's test, n = 70 and 80, p = "
    )


def test_steps_are_compared_where_all_runs_reach_the_limit(tmp_path):
    stored, store = ResultStore(Path("nowhere")), ResultStore(tmp_path, None)
    runs = {agent: stored.results("mountain-car", agent)[:4] for agent in ("circuit", "lstm")}
    for each in (*runs["circuit"], *runs["lstm"]):
        store.save(each)
    [found] = compare_agents(store, "lstm")
    assert (found.at_limit, found.verdict) == (True, "more steps")
    for each in runs["circuit"]:
        store.save(each.model_copy(update={"curve": ((1000 + each.name.seed, 95.0),)}))
    [found] = compare_agents(store, "lstm")
    assert (found.at_limit, found.verdict, found.better) == (True, "fewer steps", True)
    store.save(runs["lstm"][0].model_copy(update={"ended": "steps"}))
    [found] = compare_agents(store, "lstm")
    assert (found.at_limit, found.verdict) == (False, "worse")
    assert found.effect.difference == pytest.approx(found.means[0] - found.means[1])


def test_runs_of_different_budgets_are_not_mixed(tmp_path):
    stored, store = ResultStore(Path("nowhere")), ResultStore(tmp_path, None)
    for agent in ("circuit", "random"):
        for each in stored.results("pendulum", agent, BudgetName.PUBLISHED)[:3]:
            store.save(each)
    for each in stored.results("pendulum", "random")[:2]:
        store.save(each)
    assert compare_agents(store, "random") == []
    [found] = compare_agents(store, "random", BudgetName.PUBLISHED)
    assert (found.task, found.runs) == ("pendulum", (3, 3))


def test_an_agent_that_is_not_compared_is_one_line(capsys):
    assert run(["paper", "comparisons", "--agent", "gru"]) == 2
    assert "not with 'gru'" in capsys.readouterr().err
