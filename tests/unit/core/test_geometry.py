import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rover_ncp.core.geometry import Pose, compose, distance, inverse, relative, wrap_angle

coordinate = st.floats(-100, 100)
poses = st.builds(Pose, coordinate, coordinate, st.floats(-math.pi, math.pi))


def close(a: Pose, b: Pose) -> bool:
    return distance(a, b) < 1e-9 and abs(wrap_angle(a.theta - b.theta)) < 1e-12


@given(st.floats(-1e6, 1e6))
def test_wrapped_angle_points_the_same_way_and_lies_in_the_half_open_interval(angle):
    wrapped = wrap_angle(angle)
    assert -math.pi < wrapped <= math.pi
    assert math.cos(wrapped) == pytest.approx(math.cos(angle), abs=1e-9)
    assert math.sin(wrapped) == pytest.approx(math.sin(angle), abs=1e-9)


@given(poses, poses, poses)
def test_composition_is_associative_inverse_undoes_and_relative_is_what_it_adds(a, b, c):
    assert close(compose(compose(a, b), c), compose(a, compose(b, c)))
    assert close(compose(a, inverse(a)), Pose(0, 0, 0))
    assert close(compose(inverse(a), a), Pose(0, 0, 0))
    assert close(relative(a, compose(a, b)), b)


def test_axes_are_x_forward_y_left_theta_counter_clockwise():
    facing_left = Pose(1.0, 2.0, math.pi / 2)
    ahead = compose(facing_left, Pose(0.5, 0.0, 0.0))
    to_the_left = compose(facing_left, Pose(0.0, 0.5, 0.0))
    assert ahead == pytest.approx((1.0, 2.5, math.pi / 2))
    assert to_the_left == pytest.approx((0.5, 2.0, math.pi / 2))
