"""Courses with obstacles for larger robots."""

import numpy as np
import pytest

from rover_ncp.course.course import V_MAX, load_course
from rover_ncp.course.feasibility import check_course
from rover_ncp.course.reference import plan_reference
from rover_ncp.robot.description import load_description
from sim.evaluate.evaluate import _enlarged

PARKING, BAY = load_course("parking"), load_course("bay")
BURGER, HUSKY = load_description("turtlebot3-burger"), load_description("husky-a200")


def test_a_course_with_obstacles_is_as_large_as_the_robot_asks_for():
    room = check_course(BAY).clearance_m
    assert check_course(BAY, HUSKY).clearance_m < room / 2
    course, said = _enlarged(BAY, HUSKY)
    assert check_course(course, HUSKY).clearance_m >= room
    assert np.abs(plan_reference(course).motion[:, 0]).max() <= V_MAX
    assert "bay is 1.582 times as large for husky-a200" in said
    assert course.parked == BAY.parked


@pytest.mark.parametrize(("course", "robot"), [(PARKING, HUSKY), (BAY, BURGER)])
def test_what_has_room_stays_as_it_is(course, robot):
    assert _enlarged(course, robot) == (course, "")
