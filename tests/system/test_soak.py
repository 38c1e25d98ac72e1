"""A very short soak with real processes."""

import pytest
from faults.soak import soak
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
