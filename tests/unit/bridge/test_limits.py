"""Limits of the gate: no setting undoes the first safety requirement."""

import pytest
from pydantic import ValidationError

from bridge.gate.limits import Fence, Limits

STOP_S = 0.5


def test_fence_measures_the_distance_of_points_outside():
    fence = Fence(x_min=-1.0, x_max=2.0, y_min=-1.0, y_max=1.0)
    assert fence.outside(0.0, 0.0) == 0.0
    assert fence.outside(2.0, 1.0) == 0.0
    assert fence.outside(2.5, 0.0) == 0.5
    assert fence.outside(-1.25, 0.0) == 0.25
    assert fence.outside(0.0, 1.5) == 0.5
    assert fence.outside(3.0, -3.0) == 2.0


@pytest.mark.parametrize("sides", [(1.0, 1.0, 0.0, 1.0), (2.0, 1.0, 0.0, 1.0), (0.0, 1.0, 1.0, 1.0)])
def test_a_fence_without_an_inside_is_refused(sides):
    x_min, x_max, y_min, y_max = sides
    with pytest.raises(ValidationError, match="a fence needs"):
        Fence(x_min=x_min, x_max=x_max, y_min=y_min, y_max=y_max)


@pytest.mark.parametrize("name", ["command_timeout_s", "stale_s", "odometry_s"])
def test_no_timeout_may_be_as_long_as_the_requirement(name):
    with pytest.raises(ValidationError):
        Limits(**{name: STOP_S})
    with pytest.raises(ValidationError):
        Limits(**{name: 0.0})
