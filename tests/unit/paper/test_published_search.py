"""The paper's own searches: every iteration, its decisions, the same bits after an interruption."""

import math
from dataclasses import replace

import numpy as np
import pytest

from rover_ncp.circuit.circuit import ParameterKind
from rover_ncp.core.errors import FileError
from sim.paper import BudgetName, published_search
from sim.paper.agents import build_agent
from sim.paper.search.parking import ParkingEvaluator
from sim.paper.search.published import BenchmarkEstimator, Partial, read_partial, search_as_published
from sim.paper.results import ResultStore, RunName
from sim.paper.runs import budget_for
from sim.paper.selection import coverage
from sim.paper.tables import coverage_text
from sim.paper.tasks import TASKS

ALONE = Partial(None, {})


def budget(name, iterations, which=BudgetName.PUBLISHED, **changes):
    return replace(budget_for(TASKS[name], which), evaluations=iterations, **changes)


def search(name, limits, *, partial=ALONE, most=None):
    task = TASKS[name] if most is None else replace(TASKS[name], most=most)
    agent = build_agent(task, "circuit", 1)
    return search_as_published(BenchmarkEstimator(task, agent, 1, limits), agent, 1, limits, partial)


@pytest.mark.parametrize("which", [BudgetName.PUBLISHED, BudgetName.ALGORITHM1])
@pytest.mark.long
def test_parking_takes_every_iteration_and_its_value_is_the_return(which):
    task = TASKS["parking"]
    policy = task.policy(task.circuit())
    evaluator = ParkingEvaluator(task, policy)
    found = search_as_published(evaluator, policy, 1, budget("parking", 150, which), ALONE)
    assert found.evaluations == 151  # the start is no iteration
    assert found.curve[-1][1] == pytest.approx(evaluator.outcome(found.vector)[0])
    assert found.curve[-1][1] > found.curve[0][1]


@pytest.mark.parametrize("worst", [3, 6])
def test_rollouts_that_cannot_matter_change_no_decision(worst):
    limits = budget("cart-pole", 200, rollouts=6, worst=worst)
    early, all_rollouts = search("cart-pole", limits), search("cart-pole", limits, most=math.inf)
    assert early.curve == all_rollouts.curve
    assert early.vector.tolist() == all_rollouts.vector.tolist()


def test_a_candidate_whose_worst_rollouts_would_win_gets_the_papers_estimate():
    task, limits = TASKS["cart-pole"], budget("cart-pole", 1)
    agent = build_agent(task, "circuit", 0)
    estimator = BenchmarkEstimator(task, agent, 5, limits)
    vectors = agent.parameters()[None]
    value = estimator.estimate(vectors, 7, np.array([-math.inf]))[0]
    steps = estimator.steps
    assert estimator.estimate(vectors, 7, np.array([value - 1e-9]))[0] == value
    bound = estimator.estimate(vectors, 7, np.array([495.0]))[0]
    assert value <= bound <= 495.0
    assert estimator.steps < 3 * steps


def interrupt(limits, path, monkeypatch):
    """Interrupt a search of the cart-pole after nine states."""
    monkeypatch.setattr(published_search, "_SAVE_EVERY_S", 0.0)
    partial = Partial(path, vars(limits))
    saves = iter(range(9))
    save = partial.save

    def interrupted(state):
        save(state)
        if next(saves) == 8:
            raise KeyboardInterrupt

    monkeypatch.setattr(partial, "save", interrupted)
    with pytest.raises(KeyboardInterrupt):
        search("cart-pole", limits, partial=partial)


def test_unfinished_run_is_listed_and_counts_as_none(tmp_path, monkeypatch):
    store = ResultStore(tmp_path, None)
    name = RunName(task="cart-pole", agent="circuit", seed=1, budget=BudgetName.PUBLISHED)
    interrupt(budget("cart-pole", 50_000), store.unfinished(name), monkeypatch)
    assert store.results("cart-pole", "circuit", BudgetName.PUBLISHED) == []
    groups = coverage(store, BudgetName.PUBLISHED)
    [group] = [row for row in groups if (row["task"], row["agent"]) == ("cart-pole", "circuit")]
    [unfinished] = group["unfinished"]
    assert (group["made"], unfinished) == (0, {"seed": 1, **read_partial(store.unfinished(name))})
    assert f"seed 1 at {unfinished['iterations']} of 50000" in coverage_text(groups)


def test_an_interrupted_search_goes_on_with_the_same_bits(tmp_path, monkeypatch):
    limits = budget("cart-pole", 300, rollouts=3, worst=2)
    whole = search("cart-pole", limits)
    path = tmp_path / "circuit-00.partial"
    interrupt(limits, path, monkeypatch)
    continued = Partial(path, vars(limits))
    found = search("cart-pole", limits, partial=continued)
    assert (found.curve, found.vector.tolist()) == (whole.curve, whole.vector.tolist())
    assert continued.times()[1] > 0.0
    with pytest.raises(FileError, match="other settings"):
        Partial(path, {}).load()
    assert 0 < read_partial(path)["iterations"] <= read_partial(path)["of"] == 300
    path.write_text("{")
    with pytest.raises(FileError, match="damaged"):
        Partial(path, vars(limits)).load()


def first_step(name, returns):
    """Return the search of a task after so many returns, and the vectors that it asked for."""
    task = TASKS[name]
    policy = task.policy(task.circuit())
    own = published_search._OWN_SEARCHES[task.published_search]
    search = own.begin(policy.layout(), policy.parameters(), np.random.default_rng(0))
    asked = []
    for value in returns:
        asked.append(search.ask()[0])
        search.tell([value])
    return search, asked


@pytest.mark.parametrize("name", ["pendulum", "mountain-car"])
def test_a_lucky_incumbent_is_estimated_anew_after_51_failures(name):
    search, asked = first_step(name, [9.0, *[1.0] * 51, 4.0])
    assert asked[-1].tolist() == asked[0].tolist()
    assert not any(np.array_equal(vector, asked[0]) for vector in asked[1:-1])
    assert (search.value, search.adaptation.failures) == (4.0, 0)
    narrow, least = search.adaptation.caps, search.adaptation.least
    assert [wide - cap for wide, cap in zip(narrow, least, strict=True)] == [1] * len(least)
    search.tell([5.0] * len(search.ask()))
    assert search.adaptation.caps == least


def test_the_cars_cap_of_weights_falls_back_from_its_most():
    search, _ = first_step("mountain-car", [9.0, *([1.0] * 51 + [9.0]) * 11])
    by_kind = dict(
        zip(
            [b.kind for b in TASKS["mountain-car"].policy(TASKS["mountain-car"].circuit()).layout().blocks],
            search.adaptation.caps,
            strict=True,
        )
    )
    assert by_kind == {
        ParameterKind.WEIGHT: 12,  # 6, 7, ... 16, 12
        ParameterKind.SIGMA: 12,
        ParameterKind.LEAK_POTENTIAL: 8,
        ParameterKind.LEAK: 8,
        ParameterKind.CAPACITANCE: 7,
    }


def test_every_entry_of_a_half_cheetahs_layers_changes():
    _, (first, second) = first_step("half-cheetah", [1.0, 1.0])
    layout = TASKS["half-cheetah"].policy(TASKS["half-cheetah"].circuit()).layout()
    for kind in (ParameterKind.INPUT_LAYER, ParameterKind.OUTPUT_LAYER):
        part = layout.block(kind).slice
        assert np.all(first[part] != 0.0)
        assert np.mean(first[part] != second[part]) > 0.9  # some stay at a bound
