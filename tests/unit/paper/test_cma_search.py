"""The pendulums' search: starts far apart, the same bits again, and what is enough is confirmed."""

from dataclasses import replace

import numpy as np
import pytest

from sim.paper import cma_search
from sim.paper.agents import build_agent
from sim.paper.arena import Arena
from sim.paper.cell import Name
from sim.paper.cma_search import search_by_cma, seeds_apart
from sim.paper.tasks import TASKS, SearchName
from sim.paper.train import BudgetName, budget_for, train_cell


def arena(name, agent="circuit"):
    built = build_agent(TASKS[name], agent, 0)
    return Arena(TASKS[name], built, rough=True), built


def test_a_few_starts_cover_those_of_the_environment():
    place, _ = arena("roboschool")
    angles = place.starts(seeds_apart(place, 3, 9))[:, 1]
    assert np.diff(np.sort(angles)).max() < 0.2 / 8 * 1.1  # as if evenly spaced
    first = seeds_apart(place, 3, 4).tolist()
    assert first == seeds_apart(place, 3, 9)[:4].tolist()
    assert first != seeds_apart(place, 4, 4).tolist()
    corners = place = arena("pendulum")[0]
    apart = corners.starts(seeds_apart(place, 3, 8))
    gaps = np.linalg.norm(apart[:, None] - apart, axis=2)[~np.eye(8, dtype=bool)]
    assert gaps.min() > 0.015  # of a cube whose sides are 0.02


def test_a_perceptron_balances_within_a_few_generations_and_so_does_mujocos_pole():
    cell = train_cell(Name(task="roboschool-plain", agent="mlp", seed=0), BudgetName.QUICK)
    assert (cell.ended, cell.mean, cell.success) == ("enough", 1000.0, True)
    assert cell.settings["population"] == 16


@pytest.mark.parametrize("agent", ["circuit", "lstm"])
def test_a_search_gets_better_and_gives_the_same_bits_again(agent):
    place, built = arena("roboschool", agent)
    budget = replace(budget_for(TASKS["roboschool"], BudgetName.DEFAULT), steps=60_000, starts=100)
    found = search_by_cma(place, place, built, 1, budget)
    values = [value for _, value in found.curve]
    assert values == sorted(values)
    assert values[-1] > 2 * values[0]
    again = search_by_cma(*arena("roboschool", agent)[:1] * 2, built, 1, budget)
    assert again.vector.tolist() == found.vector.tolist()
    assert again.curve == found.curve


def test_what_a_judge_does_not_confirm_is_not_enough(monkeypatch):
    place, built = arena("roboschool-plain", "mlp")
    asked = []
    monkeypatch.setattr(cma_search, "confirmed", lambda *_: asked.append(1) or 900.0 + len(asked))
    budget = replace(budget_for(TASKS["roboschool-plain"], BudgetName.DEFAULT), steps=2_000_000, starts=100)
    found = search_by_cma(place, place, built, 0, budget)
    assert found.ended == "steps"
    assert found.curve[-1][1] == 900.0 + len(asked)


def test_only_a_long_vector_is_searched_without_rotations():
    sizes = {agent: arena("pendulum", agent)[1].layout().size for agent in ("circuit", "mlp", "lstm")}
    assert sizes["mlp"] <= 200 < sizes["lstm"]
    assert TASKS["pendulum"].search is SearchName.CMA
