"""The allowed time from a fault to standstill."""

import pytest
from faults.measure import Measured
from faults.row import braking_s
from faults.table import ROWS
from kit.true_motion import SAMPLE_S

from rover_ncp.robot.description import load_description

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
