"""The benchmarks' searches: better with time, the same bits again, and a confirmed return at the end."""

from dataclasses import replace

import numpy as np
import pytest

from sim.learn.search.base import draw_seeds
from sim.paper import BudgetName
from sim.paper.agents import build_agent
from sim.paper.evaluator import Evaluator
from sim.paper.runs import budget_for
from sim.paper.search import cma
from sim.paper.search.cma import search_by_cma, search_by_halving, spread_seeds
from sim.paper.search.estimate import BenchmarkEstimator
from sim.paper.search.parking import ParkingEvaluator, search_parking
from sim.paper.tasks import TASKS


def evaluator(name, agent="circuit"):
    built = build_agent(TASKS[name], agent, 0)
    return Evaluator(TASKS[name], built, for_search=True), built


def default_budget(name, **changes):
    return replace(budget_for(TASKS[name], BudgetName.DEFAULT), **changes)


def test_a_few_starts_cover_those_of_the_environment():
    roboschool = evaluator("roboschool")[0]
    angles = roboschool.starts(spread_seeds(roboschool, 3, 9))[:, 1]
    assert np.diff(np.sort(angles)).max() < 0.2 / 8 * 1.1  # nearly equal gaps
    first = spread_seeds(roboschool, 3, 4).tolist()
    assert first == spread_seeds(roboschool, 3, 9)[:4].tolist()
    assert first != spread_seeds(roboschool, 4, 4).tolist()
    pendulum = evaluator("pendulum")[0]
    starts = pendulum.starts(spread_seeds(pendulum, 3, 8))
    gaps = np.linalg.norm(starts[:, None] - starts, axis=2)[~np.eye(8, dtype=bool)]
    assert gaps.min() > 0.015  # of a cube whose sides are 0.02


@pytest.mark.parametrize("agent", ["circuit", "lstm"])
def test_cma_gets_better_and_gives_the_same_bits_again(agent):
    budget = default_budget("roboschool", steps=60_000, starts=100)

    def search(seed):
        place, built = evaluator("roboschool", agent)
        return search_by_cma(place, place, built, seed, budget)

    # A single search may find little in so few steps.
    found, again = [search(seed) for seed in (1, 2, 3)], search(1)
    curves = [[value for _, _, value in each.curve] for each in found]
    assert curves == [sorted(values) for values in curves]
    assert sum(values[-1] for values in curves) > 1.5 * sum(values[0] for values in curves)
    assert again.vector.tolist() == found[0].vector.tolist()
    assert again.curve == found[0].curve


@pytest.mark.long
def test_halving_gives_the_same_bits_again():
    budget = replace(budget_for(TASKS["half-cheetah"], BudgetName.QUICK), steps=20_000, starts=20)
    found = [search_by_halving(*evaluator("half-cheetah", "mlp"), seed, budget) for seed in (4, 4, 8)]
    assert found[0].vector.tolist() == found[1].vector.tolist() != found[2].vector.tolist()
    assert found[0].curve == found[1].curve
    assert min(found[0].curve[-1].value, found[2].curve[-1].value) > 100.0  # an untuned network gets about 0


def test_a_return_that_the_judge_does_not_confirm_is_not_enough(monkeypatch):
    built = build_agent(TASKS["roboschool"], "mlp", 0)
    place = Evaluator(replace(TASKS["roboschool"], enough=1100.0), built, for_search=True)
    asked = []
    monkeypatch.setattr(cma, "confirmed", lambda *_: asked.append(1) or 900.0 + len(asked))
    budget = default_budget("roboschool", steps=1_000_000, starts=100)
    found = search_by_cma(place, place, built, 0, budget)
    assert asked
    assert found.ended == "steps"
    assert found.curve[-1].value == 900.0 + len(asked)


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
