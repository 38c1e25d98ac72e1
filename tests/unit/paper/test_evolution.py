"""The search by evolution: its strategy on functions, and a short run of the half-cheetah."""

from dataclasses import replace

import numpy as np

from sim.paper.agents import build_agent
from sim.paper.arena import Arena
from sim.paper.cell import Name
from sim.paper.evolution import search_by_evolution
from sim.paper.separable import Separable
from sim.paper.tasks import TASKS
from sim.paper.train import BudgetName, budget_for, replay, train_cell


def climb(value, start, generations, seed=0):
    search = Separable(np.array(start), 0.5, seed, 16)
    for _ in range(generations):
        search.tell(np.array([value(row) for row in search.ask()]))
    return search


def test_it_finds_the_top_of_a_ridge_along_the_axes():
    lengths = 10.0 ** np.linspace(0, 3, 12)  # that differ by a thousand
    top = np.arange(12) / 10
    search = climb(lambda x: -float((((x - top) / lengths) ** 2).sum()), np.full(12, 3.0), 900)
    np.testing.assert_allclose(search.mean, top, atol=1e-3)
    assert search.spread < 0.5


def test_its_spread_grows_on_a_slope_and_the_better_come_first():
    search = climb(lambda x: float(x.sum()), np.zeros(6), 60)
    assert search.spread > 5.0
    assert search.mean.sum() > 100.0


def test_the_same_seed_is_the_same_search():
    first, same, other = (climb(lambda x: -float((x**2).sum()), np.ones(5), 5, seed) for seed in (1, 1, 2))
    assert first.mean.tolist() == same.mean.tolist() != other.mean.tolist()


def test_a_quick_run_learns_and_replays():
    cell = train_cell(Name(task="half-cheetah", agent="circuit", seed=0), BudgetName.QUICK)
    assert replay(cell)["mean"] == cell.mean
    assert cell.settings["population"] == 24
    assert cell.mean > 200.0  # an untuned one rests


def test_the_same_seed_gives_the_same_bits():
    task = TASKS["half-cheetah"]
    agent = build_agent(task, "mlp", 0)
    budget = replace(budget_for(task, BudgetName.QUICK), steps=60_000, starts=20)
    found = [search_by_evolution(Arena(task, agent, rough=True), agent, seed, budget) for seed in (3, 3, 4)]
    assert found[0].vector.tolist() == found[1].vector.tolist() != found[2].vector.tolist()
    assert found[0].curve == found[1].curve
