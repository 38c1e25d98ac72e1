"""A very short soak with real processes."""

import pytest
from faults.soak import Usage, leaks, soak
from faults.table import ROWS

pytestmark = pytest.mark.timed


@pytest.mark.parametrize("keys", [("deploy-killed", "truncated", "gone-bumper"), ("gone-bumper",)])
def test_faults_in_a_row_all_end_in_time_and_the_rover_stands(keys, tmp_path):
    # Two rounds begin if the start and the first round take less than 35 s: a row with its own mock twice.
    said = []
    assert soak(50.0, 1, tmp_path, [ROWS[key] for key in keys], said.append) == []
    *rounds, bridge_memory, mock_memory, last = said
    assert len(rounds) >= 2
    assert (bridge_memory[:7], mock_memory[:5]) == ("bridge:", "mock:")
    assert last.startswith(f"{len(rounds)} faults; not reached: ")


@pytest.mark.parametrize(
    ("change", "grown"),
    [
        (lambda at: {}, []),
        (lambda at: {"threads": 20 if at == 3 else 14 + at // 10}, ["threads grew from 14 to 17"]),
        (lambda at: {"files": 31 if at % 7 == 0 else 30}, []),
        (lambda at: {"memory_mb": 70.0 + 10.0 * min(at, 9)}, []),
        (lambda at: {"memory_mb": 60.0 if at == 37 else 70.0 + at}, ["memory_mb grew from 82 to 106"]),
    ],
    ids=["nothing", "threads", "files that are opened for a moment", "memory that settles", "memory"],
)
def test_only_growth_is_a_leak(change, grown):
    usual = Usage(0.0, 70.0, 14, 30)
    samples = [usual._replace(t_s=15.0 * at, **change(at)) for at in range(40)]
    assert list(leaks(samples, settled=10)) == grown
