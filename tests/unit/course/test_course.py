"""Courses, the verdict at their end, and the probability that it is right."""

import math

import numpy as np
import pytest

from rover_ncp.core.config import dump_yaml
from rover_ncp.core.errors import ConfigError
from rover_ncp.core.geometry import Pose
from rover_ncp.course.course import load_course
from rover_ncp.course.scoring import SURE, Failure, Parked, judge, probability_within

COURSE = load_course("parking")
GOAL, RULE = COURSE.goal, COURSE.parked
TIMES = [0.1 * k for k in range(321)]
SURE_HEADING, STD_ERROR = 1e-12, 0.004


@pytest.mark.parametrize(("tick", "signal"), [(29, 0.0), (30, 1.0)])
def test_the_start_signal_rises_at_its_tick_whatever_the_rounding(tick, signal):
    assert COURSE.start_signal(sum([0.1] * tick)) == signal
    assert COURSE.start_signal(tick / 10) == signal


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
def test_parked_is_near_the_goal_in_place_and_heading(dx, dy, dtheta, parked):
    x, y, theta = GOAL
    verdict = judge(COURSE, TIMES, [Pose(x + dx, y + dy, theta + dtheta)] * 321, touched=False)
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
def test_parked_means_still_for_two_seconds(index, dx, dtheta, failure):
    x, y, theta = GOAL
    poses = [GOAL] * 321
    poses[index] = Pose(x + dx, y, theta + dtheta)
    assert judge(COURSE, TIMES, poses, touched=False).failure is failure


def test_contact_and_an_early_end_are_not_parked():
    poses = [GOAL] * 321
    assert judge(COURSE, TIMES, poses, touched=True).failure is Failure.TOUCHED
    assert judge(COURSE, TIMES[:-30], poses[:-30], touched=False).failure is Failure.EARLY


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"horizon_s": 10.0}, "lies behind the horizon"),
        ({"start_signal_s": 100}, "the start signal (100.0 s) must come before the horizon (32.0 s)"),
        (
            {"checkpoints": [{"t": 2, "x": 0, "y": 0, "theta": 0}, {"t": 2, "x": 0, "y": 0, "theta": 0}]},
            "rising deadlines",
        ),
    ],
)
def test_a_wrong_course_is_refused_with_the_place(tmp_path, change, expected):
    data = COURSE.model_dump(mode="json") | change
    path = tmp_path / "course.yaml"
    path.write_text(dump_yaml(data))
    with pytest.raises(ConfigError) as caught:
        load_course(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert expected in str(caught.value)


def test_course_with_too_much_motion_to_plan_is_refused(tmp_path):
    path = tmp_path / "far.yaml"
    points = [{"t": 10.0 * piece, "x": 0.9 * piece, "y": 0, "theta": 0} for piece in range(20)]
    fields = {"name": "straight", "start_signal_s": 0.0, "horizon_s": 198.0, "checkpoints": points}
    path.write_text(dump_yaml(fields))
    with pytest.raises(ConfigError, match=r"far\.yaml: 190 s of motion, expected at most 180 s"):
        load_course(path)
    path.write_text(dump_yaml(fields | {"checkpoints": points[:-1]}))
    assert load_course(path).moving_s == 180.0


def of_stds(*stds):
    return np.diag(np.square(stds))


def standing_at(pose, covariance=None, touched=False):
    times = [0.0, COURSE.horizon_s - 3.0, COURSE.horizon_s]
    return judge(COURSE, times, [pose] * 3, touched, covariance)


@pytest.mark.parametrize("std_m", [0.02, 0.1])
def test_error_of_position_alone_is_a_rayleigh_distribution(std_m):
    found = probability_within(Pose(0, 0, 0), of_stds(std_m, std_m, SURE_HEADING), 0.1, 0.1)
    assert found == pytest.approx(1 - math.exp(-0.5 * (0.1 / std_m) ** 2), abs=STD_ERROR)


def test_errors_that_go_together_are_not_counted_twice():
    """Lateral and heading error of a rover whose heading is unknown: one cause, one probability."""
    apart = of_stds(SURE_HEADING, 0.1, 0.1)
    together = apart + np.array([[0, 0, 0], [0, 0, 0.01], [0, 0.01, 0]])
    at_goal = Pose(0, 0, 0)
    assert probability_within(at_goal, together, 0.1, 0.1) == pytest.approx(0.683, abs=0.01)
    assert probability_within(at_goal, apart, 0.1, 0.1) == pytest.approx(0.683**2, abs=0.01)


@pytest.mark.parametrize(("std_m", "words"), [(0.03, Parked.YES), (0.06, Parked.UNCERTAIN)])
def test_the_covariance_decides_whether_a_rover_at_its_goal_is_parked(std_m, words):
    verdict = standing_at(GOAL, of_stds(std_m, std_m, 0.01))
    assert (verdict.parked, verdict.words) == (True, words)
    assert (verdict.probability >= SURE) is (words is Parked.YES)
    assert standing_at(GOAL).words is Parked.YES  # a true pose


def test_a_miss_or_a_contact_is_not_parked_however_uncertain():
    far = Pose(GOAL.x + 0.2, GOAL.y, GOAL.theta)
    assert standing_at(far, of_stds(1, 1, 1)).words is Parked.NO
    verdict = standing_at(GOAL, of_stds(1, 1, 1)).with_contact("bumper 2")
    assert (verdict.words, verdict.failure) == (Parked.NO, Failure.TOUCHED)
