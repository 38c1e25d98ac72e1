"""The time from a fault to standstill, from a truth file."""

import pytest
from faults.measure import in_time
from faults.row import braking_s
from faults.table import ROWS

from sim.live.processes import TimedOut
from sim.live.truth import SAMPLE_S, TruthReader
from sim.pioneer.real_time import TRUTH_COLUMNS

STEP_NS = 10_000_000
EPOCH_NS = 1_700_000_000 * 10**9
HOUR_NS = 3600 * 10**9


def truth(path, speeds, set_at=None):
    """Write a sample for each speed, in m/s; before sample ``set_at`` the wall clock goes back by an hour."""
    lines = [",".join(TRUTH_COLUMNS)]
    for n, v in enumerate(speeds):
        wall_ns = EPOCH_NS + n * STEP_NS - (HOUR_NS if set_at is not None and n >= set_at else 0)
        fields = dict.fromkeys(TRUTH_COLUMNS, 0) | {"t_ns": wall_ns, "v": v, "clock_ns": n * STEP_NS}
        lines.append(",".join(str(fields[name]) for name in TRUTH_COLUMNS))
    path.write_text("\n".join(lines) + "\n")
    return TruthReader(path)


@pytest.mark.parametrize("set_at", [None, 10, 30])
def test_setting_the_wall_clock_does_not_change_the_time(tmp_path, set_at):
    reader = truth(tmp_path / "truth.csv", [0.1] * 25 + [0.0] * 50, set_at)
    assert reader.stood_after(5 * STEP_NS, 0.5) == pytest.approx(0.20)  # to the first sample that stands


def test_standing_rover_takes_no_time_and_moving_rover_times_out(tmp_path):
    reader = truth(tmp_path / "truth.csv", [0.1] * 5 + [0.0] * 50 + [0.1] * 20)
    with pytest.raises(TimedOut):
        reader.stood_after(0, 0.1)
    reader = truth(tmp_path / "truth.csv", [0.1] * 5 + [0.0] * 50)
    assert reader.stood_after(5 * STEP_NS, 0.5) == 0.0


@pytest.mark.parametrize("late_s", [0.0, 0.02])
def test_bound_is_the_requirement_plus_the_resolution_and_no_more(late_s):
    bridge_hung, braking = ROWS["bridge-hung"], braking_s(0.12)
    allowed = 2.0 + 0.15 + 0.12 / 0.31 + SAMPLE_S + late_s
    assert in_time(bridge_hung, allowed - 0.001, braking, late_s)
    assert not in_time(bridge_hung, allowed + 0.001, braking, late_s)


def test_no_time_passes_with_a_resolution_above_a_tenth_of_a_second():
    assert in_time(ROWS["bridge-hung"], 0.0, braking_s(0.12), 0.1)
    assert not in_time(ROWS["bridge-hung"], 0.0, braking_s(0.12), 0.11)
