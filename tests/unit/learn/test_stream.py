"""Lanes without a pause: the same bits as batch after batch."""

from collections.abc import Callable
from functools import partial

import numpy as np
import pytest
from paths import DATA

from rover_ncp.circuit.policy import parking_policy
from rover_ncp.circuit.policy_file import load_circuit
from rover_ncp.course.course import load_course
from sim.learn.evaluator import Evaluator
from sim.learn.flow import Lockstep
from sim.learn.objective import Deterministic
from sim.learn.stream import Stream
from sim.learn.team import AgentState, Plan, Team

POLICY = parking_policy(load_circuit("parking"))
LAYOUT = POLICY.layout()
SHORT = load_course(DATA / "short_course.yaml")


@pytest.fixture(scope="module")
def engine() -> Evaluator:
    return Evaluator(POLICY, SHORT)


def candidates(count: int, seed: int = 1) -> np.ndarray:
    noise = np.random.default_rng(seed).normal(size=(count, LAYOUT.size))
    vectors = POLICY.parameters() + 0.05 * noise * (LAYOUT.upper - LAYOUT.lower)
    return np.clip(vectors, LAYOUT.lower, LAYOUT.upper)


def plan(engine: Evaluator, strategy: str, stream: Callable[[int], Stream] | None = None) -> Plan:
    objective = Deterministic(engine.returns, engine.traces, stream)
    return Plan(5, strategy, LAYOUT, POLICY.parameters(), lambda: objective)


@pytest.mark.parametrize(("strategy", "iterations"), [("gauss-newton", 400), ("published", 200)])
def test_a_stream_decides_as_batches_do(engine: Evaluator, strategy: str, iterations: int) -> None:
    begin = [AgentState(number) for number in range(7)]  # too many to draw three candidates ahead
    in_batches = Team(plan(engine, strategy)).advance(begin, iterations)
    streamed = Team(plan(engine, strategy, partial(Stream, engine)))
    half = streamed.advance(streamed.advance(begin, 0), iterations // 2)
    assert streamed.advance(half, iterations) == in_batches


def test_answers_are_those_of_the_engine_in_any_order(engine: Evaluator) -> None:
    stream, lockstep = (
        Stream(engine, 4),
        Lockstep(Deterministic(engine.returns, engine.traces), True),
    )
    expected = {}
    for agent in range(4):
        vectors = candidates(2 + agent, seed=agent)
        nothing_to_beat = np.full(len(vectors), -np.inf)
        for flow in (stream, lockstep):
            flow.submit(agent, vectors, nothing_to_beat, [])
    for answer in lockstep.collect():
        expected[answer.agent] = answer
    seen = []
    while answers := stream.collect():
        for answer in answers:
            seen.append(answer.agent)
            assert answer.values.tolist() == expected[answer.agent].values.tolist()
            assert np.array_equal(answer.misses, expected[answer.agent].misses)
    assert sorted(seen) == [0, 1, 2, 3]
    assert lockstep.collect() == []


def test_truncated_episode_does_not_delay_the_others(engine: Evaluator) -> None:
    stream, vectors = Stream(engine, 2), candidates(8)
    whole = engine.returns(vectors)
    thresholds = np.where(np.arange(8) < 4, np.inf, whole)
    for agent in range(2):
        own = slice(4 * agent, 4 * agent + 4)
        stream.submit(agent, vectors[own], thresholds[own], [])
    first, *_ = answers = stream.collect()
    while more := stream.collect():
        answers += more
    # An agent whose candidates are truncated early gets its answer while the others still drive.
    assert first.agent == 0
    assert np.all((first.values >= whole[:4]) & (first.values < thresholds[:4]))
    assert answers[1].values.tolist() == whole[4:].tolist()


def test_an_agent_that_waits_cannot_submit_again_nor_more_than_there_is_room(engine: Evaluator) -> None:
    stream = Stream(engine, 2)
    many = np.zeros(stream.room + 1)
    with pytest.raises(ValueError, match="agent 0 cannot submit"):
        stream.submit(0, candidates(stream.room + 1), many, [])
    stream.submit(0, candidates(1), np.zeros(1), [])
    with pytest.raises(ValueError, match="agent 0 cannot submit 1"):
        stream.submit(0, candidates(1), np.zeros(1), [])
