import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rover_ncp.circuit.policy_file import load_policy
from rover_ncp.core.config import dump_yaml
from rover_ncp.core.errors import ConfigError
from rover_ncp.core.files import resolve
from rover_ncp.core.geometry import Pose
from rover_ncp.course.course import Course, Failure, load_course


@pytest.fixture(scope="module")
def parking() -> Course:
    return load_course("parking")


TIMES = [0.1 * k for k in range(321)]


def test_a_file_of_another_kind_is_one_line_with_its_keys(tmp_path):
    poses = tmp_path / "poses.yaml"
    poses.write_text("poses:\n- {x: 0, y: 0, theta: 0}\n- {x: 1, y: 0, theta: 0}\n")
    with pytest.raises(ConfigError, match=r"\$\.poses: unknown key") as caught:
        load_course(poses)
    assert "\n" not in str(caught.value)
    with pytest.raises(ConfigError, match=r"\$\.circuit: this key is missing"):
        load_policy(resolve("courses", "parking"))


@pytest.mark.parametrize(("tick", "signal"), [(0, 0.0), (29, 0.0), (30, 1.0), (31, 1.0), (320, 1.0)])
def test_the_start_signal_rises_at_its_tick_whatever_the_rounding(parking, tick, signal):
    assert parking.start_signal(sum([0.1] * tick)) == signal
    assert parking.start_signal(tick / 10) == signal


@pytest.mark.parametrize(
    ("dx", "dy", "dtheta", "parked"),
    [
        (0, 0, 0, True),
        (0.0999, 0, 0, True),
        (0.0, 0.1001, 0, False),
        (0.08, 0.08, 0, False),
        (0, 0, 0.0999, True),
        (0, 0, -0.1001, False),
        (0, 0, 6.283185307179586, True),
    ],
)
def test_parked_is_near_the_goal_in_place_and_heading(parking, dx, dy, dtheta, parked):
    x, y, theta = parking.goal
    verdict = parking.judge(TIMES, [Pose(x + dx, y + dy, theta + dtheta)] * 321, touched=False)
    assert verdict.parked is parked
    assert bool(verdict.reason) is not parked


@pytest.mark.parametrize(
    ("index", "dx", "dtheta", "failure"),
    [
        (-21, 0.006, 0.0, Failure.MOVING),
        (-22, 0.006, 0.0, Failure.NONE),
        (-15, 0.0049, 0.0, Failure.NONE),
        (-15, 0.0, 0.006, Failure.MOVING),
        (-1, math.nan, 0.0, Failure.FAR),
    ],
)
def test_parked_means_still_for_two_seconds(parking, index, dx, dtheta, failure):
    x, y, theta = parking.goal
    poses = [parking.goal] * 321
    poses[index] = Pose(x + dx, y, theta + dtheta)
    assert parking.judge(TIMES, poses, touched=False).failure is failure


def test_contact_and_an_early_end_are_not_parked(parking):
    poses = [parking.goal] * 321
    assert parking.judge(TIMES, poses, touched=True).failure is Failure.TOUCHED
    assert parking.judge(TIMES[:-30], poses[:-30], touched=False).failure is Failure.EARLY


@given(st.floats(-5, 5), st.floats(-5, 5), st.floats(-10, 10))
def test_errors_are_distances(parking, dx, dy, dtheta):
    x, y, theta = parking.goal
    verdict = parking.judge([0.0, 32.0], [Pose(x + dx, y + dy, theta + dtheta)] * 2, touched=False)
    assert verdict.error_m == pytest.approx((dx**2 + dy**2) ** 0.5, abs=1e-9)
    assert 0 <= verdict.error_rad <= 3.1416


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"horizon_s": 10.0}, "lies behind the horizon"),
        ({"horizon_s": 32.05}, "whole number"),
        ({"checkpoints": []}, "$.checkpoints"),
        (
            {"checkpoints": [{"t": 2, "x": 0, "y": 0, "theta": 0}, {"t": 2, "x": 0, "y": 0, "theta": 0}]},
            "rising deadlines",
        ),
        ({"checkpoints": [{"t": 2, "x": 0, "y": 0, "theta": 0, "z": 1}]}, "$.checkpoints[0].z: unknown key"),
        ({"checkpoints": [{"t": 2, "x": 0, "y": 0, "theta": 90}]}, "theta: an angle is in radians"),
        ({"name": "Parking lot"}, "$.name"),
        ({"obstacles": [{"x": 0, "y": 0, "length": 0, "width": 1}]}, "$.obstacles[0].length"),
        ({"format": 2}, "$.format"),
    ],
)
def test_a_wrong_course_is_refused_with_the_place(tmp_path, parking, change, expected):
    data = parking.model_dump(mode="json") | change
    path = tmp_path / "course.yaml"
    path.write_text(dump_yaml(data))
    with pytest.raises(ConfigError) as caught:
        load_course(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert expected in str(caught.value)
