"""Comparisons of controllers: each is searched and judged as the circuit is, on the same trials."""

import numpy as np
import pytest
from kit.paths import ROOT

from benchmarks import compare
from benchmarks.compare import find_agent
from benchmarks.paired import Paired, paired
from rover_ncp.course.course import load_course


@pytest.mark.parametrize(
    ("name", "numbers"),
    [
        ("circuit", 89),
        ("mlp", 90),
        ("lstm-small", 116),
        ("cfc", 104),
        ("ltc", 119),
        ("kanayama", 5),
        ("random-0", None),
        ("paper", None),
    ],
)
def test_agents_start_inside_their_bounds(name, numbers):
    box = find_agent(name, 3).box
    assert numbers is None or len(box.start) == numbers
    assert ((box.start >= 0.0) & (box.start <= 1.0)).all()
    again = find_agent(name, 3).box
    assert np.array_equal(box.vectors(box.start[None]), again.vectors(again.start[None]))


LIQUID = [pytest.param(name, marks=pytest.mark.long) for name in ("cfc", "ltc")]
"""Their kernels take longest to compile, and only benchmarks run them."""


@pytest.mark.parametrize("name", ["mlp", "lstm", *LIQUID])
def test_network_gives_the_same_return_in_any_company(name):
    agents = [find_agent(name, seed) for seed in range(20)]
    engine = agents[0].engine(load_course("parking"))
    vectors = np.array([agent.box.vectors(agent.box.start[None])[0] for agent in agents])
    together = engine.returns(vectors)
    assert len(set(together.tolist())) == 20
    alone = [engine.returns(vector[None])[0] for vector in vectors[:3]]
    assert alone == together[:3].tolist()


@pytest.mark.parametrize("name", ["circuit", "cfc", "ltc"])
def test_stored_agent_drives_as_a_policy(name, monkeypatch):
    monkeypatch.chdir(ROOT)
    found = getattr(compare, name)
    found.reset()
    assert np.isfinite(found(np.zeros(len(found.signals)))).all()


@pytest.mark.parametrize(
    ("first", "second", "p"), [(0, 0, 1.0), (3, 3, 1.0), (0, 5, 2 / 32), (5, 0, 2 / 32), (1, 9, 22 / 1024)]
)
def test_the_chance_of_a_split_is_that_of_a_coin(first, second, p):
    assert Paired(both=7, first_only=first, second_only=second, neither=2).p == pytest.approx(p)


def test_trials_are_counted_pair_by_pair():
    one = np.array([True, True, True, False, False])
    other = np.array([True, False, False, True, False])
    assert paired(one, other) == Paired(both=1, first_only=2, second_only=1, neither=1)
