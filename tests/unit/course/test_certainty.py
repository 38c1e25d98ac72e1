"""The probability that a rover is within the tolerances, and the verdict that it makes."""

import math

import numpy as np
import pytest

from rover_ncp.core.geometry import Pose
from rover_ncp.course.course import SURE, Failure, Parked, load_course, probability_within

SURE_HEADING, STD_ERROR = 1e-12, 0.004
COURSE = load_course("parking")
GOAL, RULE = COURSE.goal, COURSE.parked


def of_stds(*stds):
    return np.diag(np.square(stds))


def standing_at(pose, covariance=None, touched=False):
    times = [0.0, COURSE.horizon_s - 3.0, COURSE.horizon_s]
    return COURSE.judge(times, [pose] * 3, touched, covariance)


@pytest.mark.parametrize("std_m", [0.02, 0.05, 0.1, 0.3])
def test_error_of_position_alone_is_a_rayleigh_distribution(std_m):
    found = probability_within(Pose(0, 0, 0), of_stds(std_m, std_m, SURE_HEADING), 0.1, 0.1)
    assert found == pytest.approx(1 - math.exp(-0.5 * (0.1 / std_m) ** 2), abs=STD_ERROR)


def test_error_of_heading_alone_counts_on_both_sides():
    found = probability_within(Pose(0, 0, 0.05), of_stds(SURE_HEADING, SURE_HEADING, 0.05), 0.1, 0.1)
    phi = [0.5 * (1 + math.erf(z / math.sqrt(2))) for z in (1.0, -3.0)]
    assert found == pytest.approx(phi[0] - phi[1], abs=STD_ERROR)


def test_errors_that_go_together_are_not_counted_twice():
    """Lateral and heading error of a rover whose heading is unknown: one cause, one probability."""
    apart = of_stds(SURE_HEADING, 0.1, 0.1)
    together = apart + np.array([[0, 0, 0], [0, 0, 0.01], [0, 0.01, 0]])
    at_goal = Pose(0, 0, 0)
    assert probability_within(at_goal, together, 0.1, 0.1) == pytest.approx(0.683, abs=0.01)
    assert probability_within(at_goal, apart, 0.1, 0.1) == pytest.approx(0.683**2, abs=0.01)


def test_an_exact_estimate_is_as_certain_as_a_true_pose():
    inside, outside = Pose(GOAL.x + 0.09, GOAL.y, GOAL.theta), Pose(GOAL.x + 0.11, GOAL.y, GOAL.theta)
    nothing = np.zeros((3, 3))
    assert standing_at(inside, nothing).probability == 1.0
    assert standing_at(outside, nothing).probability == 0.0
    assert standing_at(inside).words is standing_at(inside, nothing).words is Parked.YES
    assert standing_at(outside).words is standing_at(outside, nothing).words is Parked.NO


@pytest.mark.parametrize(("std_m", "words"), [(0.03, Parked.YES), (0.06, Parked.UNCERTAIN)])
def test_the_covariance_decides_whether_a_rover_at_its_goal_is_parked(std_m, words):
    verdict = standing_at(GOAL, of_stds(std_m, std_m, 0.01))
    assert (verdict.parked, verdict.words) == (True, words)
    assert (verdict.probability >= SURE) is (words is Parked.YES)


def test_a_heading_just_inside_its_tolerance_is_uncertain():
    turned = Pose(GOAL.x, GOAL.y, GOAL.theta + 0.99 * RULE.heading_rad)
    assert standing_at(turned, of_stds(0.001, 0.001, 0.02)).words is Parked.UNCERTAIN


def test_a_miss_or_a_contact_is_not_parked_however_uncertain():
    far = Pose(GOAL.x + 0.2, GOAL.y, GOAL.theta)
    assert standing_at(far, of_stds(1, 1, 1)).words is Parked.NO
    verdict = standing_at(GOAL, of_stds(1, 1, 1)).with_contact("bumper 2")
    assert (verdict.words, verdict.failure) == (Parked.NO, Failure.TOUCHED)
