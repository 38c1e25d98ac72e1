"""Agents in lockstep: the same bits in any company, in any number of processes, in any portions."""

import multiprocessing
import os
import signal
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from paths import DATA

from rover_ncp.circuit.policy import parking_policy
from rover_ncp.circuit.policy_file import load_circuit
from rover_ncp.core.errors import UsageError
from rover_ncp.course.course import Course, load_course
from sim.learn.ensemble import Snapshot, run_ensemble
from sim.learn.evaluator import Evaluator
from sim.learn.flow import Answer, Flow
from sim.learn.objective import Deterministic, Objective, Sampled
from sim.learn.record import Task, TrainSettings
from sim.learn.team import AgentState, Plan, Team
from sim.learn.train import training_plan
from sim.learn.workers import Inline, LocalProcesses, WorkerDied

POLICY = parking_policy(load_circuit("parking"))
SHORT = load_course(DATA / "short_course.yaml")
WIDTH = POLICY.layout().upper - POLICY.layout().lower


def sphere(vectors: np.ndarray, to_beat: np.ndarray) -> np.ndarray:
    return -np.sum(((vectors - POLICY.layout().upper) / WIDTH) ** 2, axis=1)


def noisy_sphere(vectors: np.ndarray, seeds: np.ndarray) -> np.ndarray:
    noise = np.array([np.random.default_rng(seed).normal() for seed in seeds])
    return sphere(vectors, seeds) + noise


def toy_plan(objective: Objective, strategy: str = "published", seed: int = 3) -> Plan:
    return Plan(seed, strategy, POLICY.layout(), POLICY.parameters(), lambda: objective)


def parking_plan(course: Course = SHORT) -> Plan:
    return training_plan(TrainSettings(seed=5), Task(course, POLICY))


def begin(agents: int) -> Snapshot:
    return Snapshot(tuple(AgentState(number) for number in range(agents)))


class Shuffled:
    """A flow that answers in an order of its own, one agent at a time."""

    room, enough = 5, 2

    def __init__(self, chance: np.random.Generator) -> None:
        self.chance = chance
        self.waiting: dict[int, np.ndarray] = {}

    def __call__(self, agents: int) -> Flow:
        # Agents of equal chances would stay together.
        self.weights = self.chance.random(agents) ** 3
        return self

    def submit(self, agent: int, vectors: np.ndarray, to_beat: np.ndarray, keys: object) -> None:
        assert agent not in self.waiting
        self.waiting[agent] = vectors

    def collect(self) -> list[Answer]:
        if not self.waiting:
            return []
        agents = sorted(self.waiting)
        weights = self.weights[agents] / self.weights[agents].sum()
        agent = int(self.chance.choice(agents, p=weights))
        return [Answer(agent, sphere(self.waiting.pop(agent), np.zeros(0)), None)]


TOYS = {
    "published": toy_plan(Deterministic(sphere)),
    "algorithm1": toy_plan(Deterministic(sphere), "algorithm1"),
    "sampled": toy_plan(Sampled(noisy_sphere, 3, rollouts=3, worst=2), "algorithm1"),
}


@pytest.mark.parametrize("toy", sorted(TOYS))
@given(data=st.data())
@settings(max_examples=15, deadline=None)
def test_company_and_portions_change_nothing(toy: str, data: st.DataObject) -> None:
    plan = TOYS[toy]
    together = Team(plan).advance(begin(5).agents, 130)
    agents = list(begin(5).agents)
    for done in [*sorted(data.draw(st.lists(st.integers(0, 130), max_size=3))), 130]:
        order = data.draw(st.permutations(range(5)))
        cut = data.draw(st.integers(0, 5))
        for group in (order[:cut], order[cut:]):
            for agent in Team(plan).advance([agents[i] for i in group], done):
                agents[agent.number] = agent
    assert tuple(agents) == tuple(together)


def test_agents_differ_and_the_first_do_not_depend_on_how_many_follow() -> None:
    few, many = (Team(TOYS["published"]).advance(begin(n).agents, 50) for n in (2, 6))
    assert few == many[:2]
    assert len({agent.value for agent in many}) == 6


def test_improvements_tell_the_whole_curve() -> None:
    agent = Team(TOYS["published"]).advance(begin(1).agents, 200)[0]
    step_by_step = begin(1).agents[0]
    values = []
    for iterations in range(201):
        step_by_step = Team(TOYS["published"]).advance([step_by_step], iterations)[0]
        assert step_by_step.iterations == iterations
        values.append(step_by_step.value)
    assert [agent.value_at(i) for i in range(201)] == values
    assert values == sorted(values)
    assert AgentState(0).value_at(0) == AgentState(0).value == float("-inf")


def test_one_two_and_three_processes_give_the_same_bits() -> None:
    plan, results = parking_plan(), []
    with Inline(plan) as workers:
        results.append(run_ensemble(workers, begin(4), 120, lambda _: False))
    for count in (2, 3):
        with LocalProcesses(plan, count) as workers:
            results.append(run_ensemble(workers, begin(4), 120, lambda _: False))
    assert results[0] == results[1] == results[2]
    assert results[0].iterations == 120
    assert not multiprocessing.active_children()


def test_racing_decides_as_running_to_the_end() -> None:
    engine = Evaluator(POLICY, SHORT)
    thresholds: list[np.ndarray] = []

    def raced(vectors: np.ndarray, to_beat: np.ndarray) -> np.ndarray:
        thresholds.append(to_beat)
        return engine.returns(vectors, to_beat)

    to_the_end = toy_plan(Deterministic(lambda vectors, to_beat: engine.returns(vectors)))
    full = Team(to_the_end).advance(begin(3).agents, 150)
    assert Team(toy_plan(Deterministic(raced))).advance(begin(3).agents, 150) == full
    assert np.all(np.isneginf(thresholds[0]))
    assert np.all(np.isfinite(np.concatenate(thresholds[1:])))


def test_rounds_are_seen_in_order_and_can_end_the_run() -> None:
    seen: list[int] = []

    def look(snapshot: Snapshot) -> bool:
        seen.append(snapshot.iterations)
        assert all(agent.iterations == snapshot.iterations for agent in snapshot.agents)
        return snapshot.iterations >= 200

    with Inline(TOYS["published"]) as workers:
        stopped = run_ensemble(workers, begin(2), 1000, look)
        assert (stopped.iterations, seen) == (200, [0, 100, 200])
        assert run_ensemble(workers, stopped, 200, look) == stopped  # it has arrived: no callback is called
        assert seen == [0, 100, 200]
        ended = run_ensemble(workers, stopped, 250, lambda _: False)
        assert ended.iterations == 250


def test_processes_that_stop_ahead_of_time_can_go_on() -> None:
    plan = parking_plan()
    with Inline(plan) as workers:
        whole = run_ensemble(workers, begin(3), 700, lambda _: False)
    with LocalProcesses(plan, 2) as workers:
        stopped = run_ensemble(workers, begin(3), 20_000, lambda snapshot: snapshot.iterations >= 200)
        assert stopped.iterations == 200
        assert run_ensemble(workers, stopped, 700, lambda _: False) == whole


@given(seed=st.integers(0, 1000))
@settings(max_examples=15, deadline=None)
def test_however_far_some_agents_are_ahead_rounds_are_the_same(seed: int) -> None:
    plan, chance = TOYS["published"], np.random.default_rng(seed)
    apart = Team(replace(plan, build_objective=lambda: Deterministic(sphere, stream=Shuffled(chance))))
    targets, agents = [0, *range(10, 200, 10)], list(begin(5).agents)
    for target, seen in zip(targets, apart.rounds(agents, targets), strict=True):
        agents = Team(plan).advance(agents, target)
        assert seen == agents


def test_those_ahead_wait_for_the_others() -> None:
    with Inline(TOYS["published"]) as workers:
        whole = run_ensemble(workers, begin(3), 300, lambda _: False)
        early = run_ensemble(workers, begin(3), 100, lambda _: False)
        later = run_ensemble(workers, begin(3), 200, lambda _: False)
        mixed = Snapshot((early.agents[0], later.agents[1], AgentState(2)))
        assert run_ensemble(workers, mixed, 300, lambda _: False) == whole


def test_a_snapshot_knows_its_best() -> None:
    team = Team(TOYS["published"]).advance(begin(3).agents, 10)
    snapshot = Snapshot(tuple(team))
    returns = [agent.value for agent in team]
    assert snapshot.returns == returns
    assert snapshot.best == team[int(np.argmax(returns))]
    assert snapshot.median_return == sorted(returns)[1]
    assert snapshot.total_iterations == 30
    tie = replace(team[2], search=team[0].search)
    assert Snapshot((team[0], tie)).best.number == 0


def test_a_killed_process_is_a_clear_error() -> None:
    with LocalProcesses(parking_plan(), 2) as workers:
        snapshot = run_ensemble(workers, begin(2), 0, lambda _: False)
        victim = multiprocessing.active_children()[0]
        assert victim.pid is not None
        os.kill(victim.pid, signal.SIGKILL)
        with pytest.raises(
            WorkerDied, match=rf"training process train-\d \(pid {victim.pid}\) ended by SIGKILL"
        ):
            run_ensemble(workers, snapshot, 100_000, lambda _: False)
    assert not multiprocessing.active_children()


@pytest.mark.parametrize(
    ("build", "error", "message"),
    [
        (partial(load_course, "nowhere.yaml"), UsageError, "^nowhere.yaml: no such file$"),
        (partial(int, "x"), RuntimeError, "(?s)train-0 failed:.*ValueError: invalid literal"),
    ],
)
def test_a_failure_in_a_process_arrives(
    build: partial[Objective], error: type[Exception], message: str
) -> None:
    plan = replace(parking_plan(), build_objective=build)
    with LocalProcesses(plan, 1) as workers, pytest.raises(error, match=message):
        run_ensemble(workers, begin(1), 1, lambda _: False)
