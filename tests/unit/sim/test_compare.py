"""Other controllers in the circuit's place: each is searched and judged as the circuit is."""

import numpy as np
import pytest

from sim.studies.compare import compare, find_agent


@pytest.mark.parametrize(
    ("name", "numbers"),
    [("circuit", 89), ("mlp", 90), ("lstm-small", 116), ("smooth", 6), ("random-0", None), ("paper", None)],
)
def test_agents_start_inside_their_bounds(name, numbers):
    cube = find_agent(name, 3).cube
    assert numbers is None or len(cube.start) == numbers
    assert ((cube.start >= 0.0) & (cube.start <= 1.0)).all()
    again = find_agent(name, 3).cube
    assert np.array_equal(cube.vector(cube.start), again.vector(again.start))


def test_networks_draw_their_start_from_the_seed():
    starts = [find_agent("mlp", seed).cube.start for seed in (1, 2)]
    assert not np.array_equal(*starts)


def test_unknown_agent_is_refused():
    with pytest.raises(KeyError):
        find_agent("oracle", 0)


@pytest.mark.parametrize("agent", ["mlp", "kanayama"])
def test_a_comparison_says_how_far_the_search_came_and_repeats_itself(agent):
    found, again = (compare(agent, seed=1, generations=1, rollouts=1, trained_on="harsh") for _ in range(2))
    assert found["episodes"] == {"mlp": 31, "kanayama": 14}[agent]
    assert set(found) >= {"mild", "full", "harsh", "unseen", "numbers"}
    assert 0.0 <= found["full"]["success_rate"] <= 1.0
    assert found["found"] == again["found"]


def test_what_knows_one_course_is_not_judged_on_others():
    assert "unseen" not in compare("paper", seed=1, generations=1, rollouts=1, trained_on="none")
