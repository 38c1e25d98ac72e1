"""Feasible and infeasible courses, and the reason reported for each."""

import pytest

from rover_ncp.core.files import shipped_names
from rover_ncp.course.course import Checkpoint, Course, Obstacle, load_course
from rover_ncp.course.feasibility import Cause, check_course
from rover_ncp.robot.description import load_description


def course_of(*points, horizon_s=20.0, obstacles=()):
    checkpoints = tuple(Checkpoint(t=t, x=x, y=y, theta=theta) for t, x, y, theta in points)
    return Course(
        name="test", start_signal_s=0.0, horizon_s=horizon_s, checkpoints=checkpoints, obstacles=obstacles
    )


AHEAD = ((0, 0, 0, 0), (8, 0.8, 0.0, 0.0), (14, 0.8, 0.0, 0.0))


@pytest.mark.parametrize("name", shipped_names("courses"))
def test_shipped_courses_can_be_driven(name):
    course = load_course(name)
    found = check_course(course)
    assert found.drivable, found.problems
    assert max(miss.error_m for miss in found.deviations) < 0.05
    assert max(found.deviations[-1].error_m, found.deviations[-1].error_rad) < 0.001
    assert (found.clearance_m is None) == (not course.obstacles)


@pytest.mark.parametrize(
    ("points", "obstacles", "checkpoint", "cause", "words"),
    [
        (((5, 0.0, -0.5, 0.0), (14, 0.0, -0.5, 0.0)), (), 2, Cause.SIDEWAYS, "0.50 m to the right, 0.00 m"),
        (((2, 1.0, 0.0, 0.0), (14, 1.0, 0.0, 0.0)), (), 2, Cause.FAST, "0.50 m/s (at most 0.16 m/s)"),
        (((20, 2.8, 0.0, 0.0),), (), 2, Cause.REST, "in the last 2 s"),
        (AHEAD[1:], (Obstacle(x=1.3, y=0.0, length=0.5, width=0.2),), 2, Cause.OBSTACLE, "obstacle 1 at"),
    ],
)
def test_where_and_why_a_course_cannot_be_driven(points, obstacles, checkpoint, cause, words):
    found = check_course(course_of((0, 0, 0, 0), *points, obstacles=obstacles))
    assert not found.drivable
    assert {problem.cause for problem in found.problems} == {cause}
    [shown] = [str(problem) for problem in found.problems if problem.checkpoint == checkpoint]
    assert shown.startswith(f"checkpoint {checkpoint} (")
    assert f" s): {cause.value}: " in shown
    assert words in shown


def test_a_small_robot_clears_an_obstacle_that_a_larger_one_touches():
    course = course_of(*AHEAD, obstacles=(Obstacle(x=0.5, y=0.27, length=0.2, width=0.2),))
    assert check_course(course).clearance_m == 0.0
    found = check_course(course, load_description("turtlebot3-burger"))
    # The obstacle begins 0.17 m from the way; half the Burger's width is 0.105 m.
    assert found.clearance_m == pytest.approx(0.065, abs=1e-3)
    assert found.drivable
