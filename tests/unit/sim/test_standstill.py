"""The time from a fault to standstill, from a truth file."""

import pytest
from faults.measure import Measured
from faults.row import braking_s
from faults.table import ROWS
from kit.true_motion import SAMPLE_S, stood_after

from rover_ncp.robot.description import load_description
from sim.mock.real_time import TRUTH_COLUMNS
from sim.park.truth import TruthReader

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


@pytest.mark.parametrize("set_at", [None, 10])
def test_setting_the_wall_clock_does_not_change_the_time(tmp_path, set_at):
    reader = truth(tmp_path / "truth.csv", [0.1] * 25 + [0.0] * 50, set_at)
    assert stood_after(reader, 5 * STEP_NS, 0.5) == pytest.approx(0.20)  # to the first sample that stands


PIONEER, HUSKY = load_description("p3at-sh"), load_description("husky-a200")


@pytest.mark.parametrize(
    ("key", "robot", "allowed_s"),
    [
        ("bridge-hung", PIONEER, 2.0 + 0.15 + 0.12 / 0.31),
        ("bridge-hung", HUSKY, 0.5 + 0.1 + 0.12 / 1.0),
        ("low-battery", HUSKY, 0.5 + 2.0 + 1.0 + 0.1 + 0.12 / 1.0),
    ],
)
def test_bound_is_the_requirement_plus_the_resolution_and_no_more(key, robot, allowed_s):
    def stop(seconds):
        bound_s = ROWS[key].bound_s(robot)
        return Measured(ROWS[key], 0, seconds, bound_s, braking_s(robot, 0.12), 0.02)

    assert stop(allowed_s + SAMPLE_S + 0.02 - 0.001).in_time
    assert not stop(allowed_s + SAMPLE_S + 0.02 + 0.001).in_time
