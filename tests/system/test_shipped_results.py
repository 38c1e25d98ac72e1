"""Results that are shipped or documented can be made again; too slow for the unit tests."""

import pytest

from benchmarks.compare import compare


@pytest.mark.parametrize("agent", ["mlp", "kanayama"])
def test_a_comparison_says_how_far_the_search_came_and_repeats_itself(agent):
    found, again = (compare(agent, seed=1, generations=1, rollouts=1, trained_on="harsh") for _ in range(2))
    assert found["episodes"] == {"mlp": 31, "kanayama": 14}[agent]
    assert set(found) >= {"mild", "full", "harsh", "unseen", "numbers"}
    assert 0.0 <= found["full"]["success_rate"] <= 1.0
    assert found["found"] == again["found"]


def test_what_knows_one_course_is_not_judged_on_others():
    assert "unseen" not in compare("paper", seed=1, generations=1, rollouts=1, trained_on="none")
