"""The paper's own searches: the decisions of their references, and the same bits after an interruption."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from kit import paper_reference as reference

from paper import loop
from paper.agents import build_agent
from paper.evaluator import Evaluator
from paper.loop import BenchmarkEstimator, Checkpoint, ParkingEvaluator, run_search
from paper.runs import budget_for
from paper.searches import SEARCHES
from paper.store import BudgetName
from paper.tasks import TASKS, Benchmark
from rover_ncp.circuit.circuit import ParameterKind
from rover_ncp.core.errors import FileError
from sim.learn.search.algorithm1 import ALPHA, ESTIMATE_AFTER, START_SCALE
from sim.learn.search.base import draw_seeds

ALONE = Checkpoint(None, {})
LAYERS = (ParameterKind.INPUT_LAYER, ParameterKind.OUTPUT_LAYER)


def budget(name, iterations, which=BudgetName.PUBLISHED, **changes):
    return replace(budget_for(TASKS[name], which), iterations=iterations, **changes)


def search(name, limits, *, checkpoint=ALONE, most=None):
    task = TASKS[name] if most is None else TASKS[name].model_copy(update={"most": most})
    return run_search(task, build_agent(task, "circuit", 1), 1, limits, checkpoint)


def fast(strategy, agent, returns, iterations, ahead=7):
    """Return the incumbent and its value by iteration where a fast search may change them."""
    first = agent.parameters() if hasattr(agent, "parameters") else np.zeros(agent.layout().size)
    found = SEARCHES[strategy].begin(agent.layout(), first, np.random.default_rng(5))
    states = {}
    while found.iterations < iterations or found.wants_estimate(found.adaptation):
        vectors = found.ask(max(min(ahead, iterations - found.iterations), 1))
        found.tell(returns(found.evaluations, vectors))
        states[found.iterations] = found.incumbent, found.value  # most estimates take no iteration
    return states


def literal(strategy, agent, evaluate, iterations):
    """Return the same from the reference."""
    rng, layout = np.random.default_rng(5), agent.layout()
    if strategy == "published-network":
        return reference.published_network_search(evaluate, layout.size, rng, iterations)
    bounds = agent.parameters(), layout.lower, layout.upper
    if strategy == "algorithm1":
        numbers = START_SCALE, ALPHA, ESTIMATE_AFTER
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
    assert max(quick) == iterations
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


@pytest.mark.parametrize(
    ("strategy", "name"),
    [
        ("published-parking", "parking"),
        ("published-mountain-car", "mountain-car"),
        ("published-cart-pole", "cart-pole"),
        ("algorithm1", "cart-pole"),
    ],
)
@pytest.mark.long
def test_fast_search_makes_the_decisions_of_the_reference_on_a_task(strategy, name):
    task = TASKS[name]
    agent = build_agent(task, "circuit", 0)
    limits = replace(budget_for(task, BudgetName.PUBLISHED), rollouts=2, worst=1)
    if isinstance(task, Benchmark):
        place = BenchmarkEstimator(task, agent, 3, limits)
    else:
        place = ParkingEvaluator(task, agent)

    def returns(number, vectors):
        return place.estimate(vectors, number, np.full(len(vectors), -math.inf))

    assert_same(strategy, agent, returns)


def test_estimate_is_the_mean_of_the_worst_and_stops_below_what_it_must_beat():
    task, limits = TASKS["cart-pole"], budget("cart-pole", 1)
    policy = build_agent(task, "circuit", 0)
    place = BenchmarkEstimator(task, policy, 5, limits)
    vectors = np.tile(policy.parameters(), (3, 1))
    full = place.estimate(vectors, 7, np.full(3, -np.inf))
    steps = place.steps
    returns = [place.returns(vectors[:1], draw_seeds(5, (1, number), 20))[0] for number in (7, 8, 9)]
    assert full == pytest.approx(np.sort(returns)[:, :10].mean(axis=1))
    assert place.estimate(vectors, 7, full - 1e-9).tolist() == full.tolist()
    place.steps = 0
    bound = place.estimate(vectors, 7, np.full(3, 400.0))
    assert np.all((full <= bound) & (bound <= 400.0))
    assert place.steps < steps


@pytest.mark.parametrize("worst", [3, 6])
def test_rollouts_that_cannot_matter_change_no_decision(worst):
    limits = budget("cart-pole", 200, rollouts=6, worst=worst)
    early, all_rollouts = search("cart-pole", limits), search("cart-pole", limits, most=math.inf)
    points = [[(each.iterations, each.value) for each in found.curve] for found in (early, all_rollouts)]
    assert points[0] == points[1]
    assert early.vector.tolist() == all_rollouts.vector.tolist()


class Interrupted(Checkpoint):
    """A checkpoint of a search that is interrupted after nine states."""

    saves = 0

    def save(self, state):
        super().save(state)
        self.saves += 1
        if self.saves == 9:
            raise KeyboardInterrupt


@pytest.mark.parametrize("which", [BudgetName.PUBLISHED, BudgetName.ALGORITHM1])
def test_interrupted_search_continues_with_the_same_bits(which, tmp_path, monkeypatch):
    monkeypatch.setattr(loop, "_CHECKPOINT_S", 0.0)
    limits = budget("cart-pole", 300, which, rollouts=3, worst=2)
    whole = search("cart-pole", limits)
    path = tmp_path / "circuit.json"
    with pytest.raises(KeyboardInterrupt):
        search("cart-pole", limits, checkpoint=Interrupted(path, vars(limits)))
    continued = Checkpoint(path, vars(limits))
    found = search("cart-pole", limits, checkpoint=continued)
    assert (found.curve, found.vector.tolist()) == (whole.curve, whole.vector.tolist())
    assert continued.times()[1] > 0.0
    refusal = pytest.raises(FileError, match=r"damaged, or not of this run; .* again$")
    with refusal:
        Checkpoint(path, {}).load()
    with refusal:
        Checkpoint(path.rename(tmp_path / "other.json"), vars(limits)).load()


def test_published_network_takes_raw_inputs_and_ends_at_one():
    net = build_agent(TASKS["pendulum"], "mlp", 0)
    assert (net.cells, net.scale, net.low, net.high) == (12, (1.0, 1.0), (-1.0,), (1.0,))
    assert set(net.most) == {math.inf}


def test_warm_up_tick_changes_an_episode_but_not_its_length():
    task = TASKS["pendulum"].model_copy(update={"horizon": 5})
    agent = build_agent(task, "circuit", 0)
    vectors, seeds = np.tile(agent.parameters(), (40, 1)), np.arange(40, dtype=np.uint64)
    cold, warm = (
        Evaluator(task, agent, for_search=True, warm_up=ticks).run(vectors, seeds) for ticks in (0, 1)
    )
    assert cold[:, 2].tolist() == warm[:, 2].tolist() == [5.0] * 40
    assert cold[:, 1].tolist() != warm[:, 1].tolist()


def test_play_has_the_warm_up_of_the_scored_episodes():
    task = TASKS["pendulum"]
    agent = build_agent(task, "circuit", 0)
    found = Evaluator(task, agent)
    scored = found.run(agent.parameters()[None], np.array([3], np.uint64))
    assert found.play(3).rewards.sum() == pytest.approx(scored[0, :2].sum(), abs=1e-9)
    cold = Evaluator(task, agent, warm_up=0).run(agent.parameters()[None], np.array([3], np.uint64))
    assert cold[0, 1] != scored[0, 1]


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
