"""The paper's own searches: the decisions of their references."""

import itertools
import math
import time
from dataclasses import replace

import numpy as np
import pytest
from kit import paper_reference as reference

from paper import search as search_module
from paper.episodes import PlantEvaluator
from paper.runs import budget_for
from paper.search import (
    STRATEGIES,
    BenchmarkEstimator,
    Progress,
    PublishedOnNetworks,
    SavedSearch,
    climb,
    run_search,
)
from paper.store import RunName
from paper.tasks import TASKS, build_agent, draw_seeds
from rover_ncp.circuit.circuit import ParameterKind
from rover_ncp.core.errors import FileError
from sim.learn.search.algorithm1 import ALPHA, ESTIMATE_AFTER, SIGMA

LAYERS = (ParameterKind.INPUT_LAYER, ParameterKind.OUTPUT_LAYER)


def budget(name, iterations, **changes):
    return replace(budget_for(RunName(task=name, agent="circuit", seed=0)), iterations=iterations, **changes)


def search(name, limits, *, most=None):
    task = TASKS[name] if most is None else TASKS[name].model_copy(update={"most": most})
    return run_search(task, build_agent(task, "circuit", 1), 1, limits)


def fast(strategy, agent, returns, iterations):
    """Return the incumbent and its value by iteration where it changes."""
    if strategy == "published-network":
        rule, first = PublishedOnNetworks(), np.zeros(sum(agent.sizes))
    else:
        rule, first = STRATEGIES[strategy](agent.layout()), agent.parameters()
    states = {}

    def estimate(vectors, number, to_beat):
        return np.array(returns(number, vectors))

    rng = np.random.default_rng(5)
    start = Progress(rule.first(first, rng), rule.start, rng.bit_generator.state)
    for now in climb(rule, start, iterations, estimate):
        states[now.done] = now.incumbent, now.value
    return states


def literal(strategy, agent, evaluate, iterations):
    """Return the same from the reference."""
    rng = np.random.default_rng(5)
    if strategy == "published-network":
        return reference.published_network_search(evaluate, sum(agent.sizes), rng, iterations)
    layout = agent.layout()
    bounds = agent.parameters(), layout.lower, layout.upper
    if strategy == "algorithm1":
        numbers = SIGMA, ALPHA, ESTIMATE_AFTER
        return reference.algorithm1(evaluate, *bounds, rng, iterations, *numbers)
    table = {"published-mountain-car": reference.MOUNTAIN_CAR, "published-cart-pole": reference.CART_POLE}
    kinds = [table.get(strategy, reference.PENDULUM)[block.kind] for block in layout.blocks]
    slices = [block.slice for block in layout.blocks if block.kind in LAYERS]
    assert layout.blocks[0].kind is ParameterKind.WEIGHT
    return reference.published_circuit_search(
        evaluate,
        *bounds,
        [block.slice for block in layout.blocks],
        kinds,
        rng,
        iterations,
        estimates={"published-parking": None, "published-cart-pole": "own"}.get(strategy, "in"),
        falls_back=(16, 12) if strategy == "published-mountain-car" else None,
        layers=[index for each in slices for index in range(layout.size)[each]],
    )


def assert_same(strategy, agent, returns, iterations=2000):
    number = itertools.count()
    slow = literal(strategy, agent, lambda vector: returns(next(number), vector[None])[0], iterations)
    quick = fast(strategy, agent, returns, iterations)
    assert len(quick) > 5
    vector, value = quick[0]
    for iteration, (expected, wanted) in enumerate(slow, start=1):
        vector, value = quick.get(iteration, (vector, value))
        assert value == wanted
        assert vector.tolist() == expected.tolist()


CELLS = [
    ("algorithm1", "pendulum", "circuit"),
    ("published-parking", "parking", "circuit"),
    ("published-benchmarks", "pendulum", "circuit"),
    ("published-benchmarks", "half-cheetah", "circuit"),
    ("published-mountain-car", "mountain-car", "circuit"),
    ("published-cart-pole", "cart-pole", "circuit"),
    ("published-network", "mountain-car", "lstm"),
]


@pytest.mark.parametrize(("strategy", "task", "name"), CELLS)
def test_fast_search_makes_the_decisions_of_the_reference_on_recorded_returns(strategy, task, name):
    # Successes become rare, as in a search, and a new estimate is often lower.
    recorded = np.random.default_rng(2).gumbel(size=10_000) + np.linspace(0.0, 9.0, 10_000)
    agent = build_agent(TASKS[task], name, 0)
    assert_same(strategy, agent, lambda number, vectors: recorded[number : number + len(vectors)])


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


class Killed(SavedSearch):
    """Ends its search after the 20th batch."""

    batches = 0

    def save(self, *progress):
        super().save(*progress)
        self.batches += 1
        if self.batches == 20:
            raise KeyboardInterrupt


def test_search_that_was_killed_goes_on_to_the_same_bits(tmp_path, monkeypatch):
    monkeypatch.setattr(search_module, "_SAVE_STEPS", 0)
    task, limits = TASKS["cart-pole"], budget("cart-pole", 150, rollouts=4, worst=2)
    agent, path = build_agent(task, "circuit", 1), tmp_path / "run"
    whole = run_search(task, agent, 1, limits)
    with pytest.raises(KeyboardInterrupt):
        run_search(task, agent, 1, limits, Killed(path, {"commit": "a"}, time.process_time))
    with pytest.raises(FileError, match="run"):
        run_search(task, agent, 1, limits, SavedSearch(path, {"commit": "b"}, time.process_time))
    after = SavedSearch(path, {"commit": "a"}, time.process_time)
    assert 0 < after.load()[0].done < 150
    assert str(run_search(task, agent, 1, limits, after)) == str(whole)


def test_unstable_simulation_is_never_the_best(monkeypatch):
    task = TASKS["half-cheetah"]
    agent = build_agent(task, "circuit", 0)
    place = PlantEvaluator(task, agent)
    starts = place.starts(np.arange(2, dtype=np.uint64))
    starts[0, -1] = 1e11
    monkeypatch.setattr(place, "starts", lambda seeds: starts)
    found = place.run(np.tile(agent.parameters(), (2, 1)), np.arange(2, dtype=np.uint64))
    assert found[0, :2].tolist() == [-1e6, 0.0]
    assert found[1, 0] > -1e5
