"""The paper's own searches: what they estimate, and which rollouts they leave out."""

import math
from dataclasses import replace

import numpy as np
import pytest

from paper.episodes import Evaluator
from paper.runs import BudgetName, budget_for
from paper.search import BenchmarkEstimator, run_search
from paper.tasks import TASKS, build_agent, draw_seeds


def budget(name, iterations, **changes):
    return replace(budget_for(TASKS[name], BudgetName.PUBLISHED), iterations=iterations, **changes)


def search(name, limits, *, most=None):
    task = TASKS[name] if most is None else TASKS[name].model_copy(update={"most": most})
    return run_search(task, build_agent(task, "circuit", 1), 1, limits)


def test_estimate_is_the_mean_of_the_worst_and_stops_below_what_it_must_beat():
    task, limits = TASKS["cart-pole"], budget("cart-pole", 1)
    policy = build_agent(task, "circuit", 0)
    place = BenchmarkEstimator(task, policy, 5, limits)
    vectors = np.tile(policy.parameters(), (20, 1))
    full = place.estimate(vectors[:3], 7, -math.inf)
    steps = place.steps
    returns = [place.run(vectors, draw_seeds(5, (1, number), 20))[:, 0] for number in (7, 8, 9)]
    assert full == pytest.approx(np.sort(returns)[:, :10].mean(axis=1))
    assert place.estimate(vectors[:3], 7, min(full) - 1e-9).tolist() == full.tolist()
    place.steps = 0
    bound = place.estimate(vectors[:3], 7, 400.0)
    assert np.all((full <= bound) & (bound <= 400.0))
    assert place.steps < steps


def test_rollouts_that_cannot_matter_change_no_decision():
    limits = budget("cart-pole", 200, rollouts=6, worst=3)
    early, all_rollouts = search("cart-pole", limits), search("cart-pole", limits, most=math.inf)
    points = [[(done, value) for done, _, value in found.curve] for found in (early, all_rollouts)]
    assert points[0] == points[1]
    assert early.vector.tolist() == all_rollouts.vector.tolist()


def test_unstable_simulation_is_never_the_best(monkeypatch):
    task = TASKS["half-cheetah"]
    agent = build_agent(task, "circuit", 0)
    place = Evaluator(task, agent)
    starts = place.starts(np.arange(2, dtype=np.uint64))
    starts[0, -1] = 1e11
    monkeypatch.setattr(place, "starts", lambda seeds: starts)
    found = place.run(np.tile(agent.parameters(), (2, 1)), np.arange(2, dtype=np.uint64))
    assert found[0, :2].tolist() == [-1e6, 0.0]
    assert found[1, 0] > -1e5
