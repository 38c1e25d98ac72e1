"""Agents give the same bits in any company and any number of processes, with any pauses."""

import multiprocessing
import pickle
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from kit.paths import DATA
from kit.toy_search import LAYOUT, POLICY, candidates

from rover_ncp.course.course import load_course
from sim.learn import agents as agents_module
from sim.learn.agents import AgentState, Batch, Plan, Snapshot, note_improvement, run_rounds
from sim.learn.curve import curve_iterations
from sim.learn.engine.evaluator import Answer, Evaluator, Stream
from sim.learn.record import Task, TrainSettings
from sim.learn.search.base import dump_state
from sim.learn.train import training_plan
from sim.learn.workers import Inline, ProcessPool, WorkerDied

SHORT = load_course(DATA / "short_course.yaml")


class ToyEvaluator:
    """The distance of a vector to a corner; agents are answered one at a time, in a random order."""

    def __init__(self, seed=0):
        self.chance = np.random.default_rng(seed)

    def stream(self, agents):
        return ToyStream(self.chance, agents)


class ToyStream:
    room, enough = 5, 2

    def __init__(self, chance, agents):
        self.chance, self.waiting = chance, {}
        # Agents of equal chances would stay together.
        self.weights = chance.random(agents) ** 3

    def submit(self, agent, vectors, thresholds):
        assert agent not in self.waiting
        self.waiting[agent] = vectors

    def collect(self):
        if not self.waiting:
            return []
        waiting = sorted(self.waiting)
        weights = self.weights[waiting] / self.weights[waiting].sum()
        agent = int(self.chance.choice(waiting, p=weights))
        apart = (self.waiting.pop(agent) - LAYOUT.upper) / (LAYOUT.upper - LAYOUT.lower)
        return [Answer(agent, -np.sum(apart**2, axis=1), None)]


def toy_plan(strategy="published", order=0):
    return Plan(3, strategy, POLICY, partial(ToyEvaluator, order))


def parking_plan(strategy="gauss-newton"):
    return training_plan(TrainSettings(seed=5, search=strategy), Task(SHORT, POLICY))


def begin(count):
    return [AgentState(number) for number in range(count)]


def advance(plan, agents, iterations):
    batch = plan if isinstance(plan, Batch) else Batch(plan)
    return [states[-1] for states in batch.advance(agents, [iterations])]


def as_data(agents):
    """Return what is saved of agents, which can be compared."""
    return [(agent.number, dump_state(agent.search), agent.improvements) for agent in agents]


def train(workers, plan, agents, iterations, after_round=lambda _: False):
    """Return the snapshot at the end."""
    return run_rounds(workers, plan, Snapshot(tuple(agents)), iterations, after_round)


@pytest.mark.parametrize("strategy", ["published", "algorithm1"])
@given(data=st.data())
@settings(max_examples=settings().max_examples // 8)
def test_company_order_and_pauses_change_nothing(strategy, data):
    together = advance(toy_plan(strategy), begin(5), 130)
    assert len({agent.value for agent in together}) == 5
    agents = begin(5)
    for done in [*sorted(data.draw(st.lists(st.integers(0, 130), max_size=3))), 130]:
        order = data.draw(st.permutations(range(5)))
        cut = data.draw(st.integers(0, 5))
        plan = toy_plan(strategy, data.draw(st.integers(0, 1000)))
        for group in filter(None, (order[:cut], order[cut:])):
            for agent in advance(plan, [agents[i] for i in group], done):
                agents[agent.number] = agent
    assert as_data(agents) == as_data(together)


@pytest.mark.parametrize(("strategy", "iterations"), [("gauss-newton", 400), ("published", 200)])
def test_agents_that_share_lanes_decide_as_alone(strategy, iterations):
    batch = Batch(parking_plan(strategy))
    together = advance(batch, begin(7), iterations)  # too many to draw three candidates ahead
    apart = advance(batch, advance(batch, begin(7)[2:4], iterations // 2), iterations)
    assert as_data(apart) == as_data(together[2:4])


def test_truncated_episodes_change_no_decision(monkeypatch):
    plan, thresholds = parking_plan("published"), []
    truncated = advance(plan, begin(3), 150)
    submit = Stream.submit

    def to_the_end(stream, agent, vectors, to_beat):
        thresholds.extend(to_beat)
        submit(stream, agent, vectors, np.full(len(vectors), -np.inf))

    monkeypatch.setattr(Stream, "submit", to_the_end)
    assert as_data(advance(plan, begin(3), 150)) == as_data(truncated)
    assert np.isneginf(thresholds[:3]).all()
    assert np.isfinite(thresholds[3:]).all()


@pytest.mark.parametrize("last", [200, 1234])
def test_improvements_are_the_whole_curve(last):
    (agent,) = advance(toy_plan(), begin(1), last)
    (states,) = Batch(toy_plan()).advance(begin(1), range(last + 1))
    assert [state.iterations for state in states] == list(range(last + 1))
    values = [state.value for state in states]
    assert values == sorted(values)
    shown = curve_iterations(last)
    assert [agent.value_at(i) for i in shown] == [values[i] for i in shown]
    assert AgentState(0).value_at(0) == AgentState(0).value == float("-inf")


def test_curve_of_a_search_that_always_improves_stays_small():
    improvements = []
    for iteration in range(50_001):
        note_improvement(improvements, iteration, float(iteration))
    assert len(improvements) < 400
    agent = AgentState(0, improvements=tuple(improvements))
    assert [agent.value_at(i) for i in (0, 7, 100, 1200, 50_000)] == [0, 7, 100, 1200, 50_000]


def test_work_handed_out_does_not_grow_with_the_number_of_iterations():
    sizes = []

    class Measuring(Inline):
        def submit(self, function, /, *arguments):
            sizes.append(len(pickle.dumps(arguments)))
            return super().submit(function, *arguments)

    train(Measuring(), toy_plan(), begin(2), 10**7, lambda snapshot: True)
    assert max(sizes) < 10_000


@pytest.mark.parametrize("call_iterations", [1, 300, 10_000])
@pytest.mark.long
def test_processes_and_lengths_of_calls_give_the_same_rounds(call_iterations, monkeypatch):
    monkeypatch.setattr(agents_module, "_CALL_ITERATIONS", call_iterations)
    plan, seen = parking_plan(), {}
    for count in (1, 2, 3):
        with Inline() if count == 1 else ProcessPool(count) as workers:
            train(workers, plan, begin(4), 220, lambda last, n=count: seen.setdefault(n, []).append(last))
    rounds = [[as_data(snapshot.agents) for snapshot in seen[count]] for count in (1, 2, 3)]
    assert rounds[0] == rounds[1] == rounds[2]
    assert [snapshot.iterations for snapshot in seen[1]] == [0, 100, 200, 220]
    assert not multiprocessing.active_children()


def test_rounds_are_seen_in_order_and_can_end_the_run():
    seen = []

    def look(snapshot):
        seen.append(snapshot.iterations)
        assert all(agent.iterations == snapshot.iterations for agent in snapshot.agents)
        return snapshot.iterations >= 200

    stopped = train(Inline(), toy_plan(), begin(2), 1000, look)
    assert (stopped.iterations, seen) == (200, [0, 100, 200])
    assert train(Inline(), toy_plan(), stopped.agents, 200, look) == stopped  # arrived: no callback is called
    assert seen == [0, 100, 200]
    assert train(Inline(), toy_plan(), stopped.agents, 250).iterations == 250


def test_a_run_that_is_stopped_early_can_continue():
    plan = parking_plan()
    whole = train(Inline(), plan, begin(3), 400)
    workers = Inline()
    workers.count = 2
    stopped = train(workers, plan, begin(3), 20_000, lambda snapshot: snapshot.iterations >= 200)
    assert stopped.iterations == 200
    assert as_data(train(workers, plan, stopped.agents, 400).agents) == as_data(whole.agents)


def test_agents_that_are_ahead_wait_for_the_others():
    whole, early, later = (train(Inline(), toy_plan(), begin(3), until) for until in (300, 100, 200))
    mixed = [early.agents[0], later.agents[1], AgentState(2)]
    assert as_data(train(Inline(), toy_plan(), mixed, 300).agents) == as_data(whole.agents)


def test_a_snapshot_has_median_total_and_the_first_of_the_best():
    agents = advance(toy_plan(), begin(3), 10)
    values, best = [agent.value for agent in agents], max(agents, key=lambda agent: agent.value)
    found = Snapshot(tuple(agents))
    assert (found.returns, found.median_return, found.total_iterations) == (values, sorted(values)[1], 30)
    assert Snapshot((*agents, replace(best, number=7))).best == found.best == best


# -- the stream of candidates ------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def evaluator():
    return Evaluator(POLICY, SHORT)


def test_truncated_episode_does_not_delay_the_others(evaluator):
    stream, vectors = evaluator.stream(2), candidates(8)
    whole = evaluator.returns(vectors)
    thresholds = np.where(np.arange(8) < 4, np.inf, whole)
    for agent in range(2):
        own = slice(4 * agent, 4 * agent + 4)
        stream.submit(agent, vectors[own], thresholds[own])
    first, *_ = answers = stream.collect()
    while more := stream.collect():
        answers += more
    assert first.agent == 0
    assert np.all((first.returns >= whole[:4]) & (first.returns < thresholds[:4]))
    assert answers[1].returns.tolist() == whole[4:].tolist()


def test_an_agent_that_waits_cannot_submit_again_nor_more_than_there_is_room(evaluator):
    stream = evaluator.stream(2)
    with pytest.raises(ValueError, match="agent 0 cannot submit"):
        stream.submit(0, candidates(stream.room + 1), np.zeros(stream.room + 1))
    stream.submit(0, candidates(1), np.zeros(1))
    with pytest.raises(ValueError, match="agent 0 cannot submit 1"):
        stream.submit(0, candidates(1), np.zeros(1))


@pytest.mark.parametrize("answer", [None, [], "done"])
def test_a_worker_that_answers_no_result_is_named(answer):
    class Foreign(Inline):
        def submit(self, function, /, *arguments):
            return super().submit(lambda: answer)

    with pytest.raises(WorkerDied, match="expected 1 results in list"):
        run_rounds(Foreign(), toy_plan(), Snapshot((AgentState(0),)), 10, lambda snapshot: False)
