"""The benchmarks' searches: better with time, the same bits again, and a confirmed return at the end."""

from dataclasses import replace

import numpy as np
import pytest

from sim.learn.search.base import draw_seeds
from sim.paper import BudgetName
from sim.paper.agents import build_agent
from sim.paper.runs import budget_for
from sim.paper.search import loop
from sim.paper.search.estimate import BenchmarkEstimator, ParkingEvaluator
from sim.paper.search.loop import Checkpoint, search_from_one, search_parking
from sim.paper.tasks import TASKS


def default_budget(name, **changes):
    return replace(budget_for(TASKS[name], BudgetName.DEFAULT), **changes)


def test_an_estimate_is_the_papers_and_takes_no_rollouts_that_cannot_matter():
    task, policy = TASKS["cart-pole"], build_agent(TASKS["cart-pole"], "circuit", 0)
    published, pruning = (
        BenchmarkEstimator(task, policy, 5, budget_for(task, which))
        for which in (BudgetName.PUBLISHED, BudgetName.DEFAULT)
    )
    vectors, unbeaten = np.tile(policy.parameters(), (3, 1)), np.full(3, -np.inf)
    full = published.estimate(vectors, 7, unbeaten)
    steps = published.steps
    returns = published.returns(vectors[:1], draw_seeds(5, (1, 7), 20))[0]
    assert full[0] == pytest.approx(np.sort(returns)[:10].mean())
    assert published.estimate(vectors, 7, full - 1e-9).tolist() == full.tolist()
    assert pruning.estimate(vectors, 7, unbeaten).tolist() == full.tolist()
    published.steps = pruning.steps = 0
    bound, pruned = (place.estimate(vectors, 7, np.full(3, 400.0)) for place in (published, pruning))
    assert np.all((full <= bound) & (np.maximum(bound, pruned) <= 400.0))
    assert pruning.steps < 3 * 60 < published.steps < steps  # one rollout each


@pytest.mark.parametrize("name", ["parking", "four-dof"])
def test_creeping_counts_as_a_miss_and_in_no_return(name):
    task = TASKS[name]
    policy = task.policy(task.circuit())
    place = ParkingEvaluator(task, policy)
    values, counted, misses = place.traces(policy.parameters()[None])
    assert values == pytest.approx(place.outcome(policy.parameters())[0])
    assert counted == pytest.approx(-np.sum(misses**2, axis=(1, 2, 3)))
    assert (counted < values).all()
    found = search_parking(place, policy, 1, default_budget(name, evaluations=300))
    assert found.curve[-1].value == place.outcome(found.vector)[0]


@pytest.mark.parametrize(("fresh", "ended"), [(50.0, "steps"), (61.0, "enough")])
def test_a_return_is_enough_only_where_fresh_episodes_confirm_it(fresh, ended, monkeypatch):
    default = TASKS["cart-pole"].default._replace(enough=60.0)
    task = TASKS["cart-pole"].model_copy(update={"default": default})
    policy, budget = build_agent(task, "circuit", 0), default_budget("cart-pole", steps=30_000, starts=50)
    asked = []
    monkeypatch.setattr(loop, "confirmed", lambda *_: asked.append(1) or fresh)
    place = BenchmarkEstimator(task, policy, 0, budget)
    found = search_from_one(place, policy, 0, budget, Checkpoint(None, {}))
    assert asked
    assert found.ended == ended
    assert (found.curve[-1].value >= 60.0) is (ended == "enough")
