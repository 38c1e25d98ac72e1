"""Courses for slower robots."""

import numpy as np
import pytest

from rover_ncp.core.errors import ConfigError
from rover_ncp.course.course import OMEGA_MAX, V_MAX, load_course
from rover_ncp.course.reference import COMMAND_MAX, plan_reference
from rover_ncp.course.slowdown import slowed
from rover_ncp.robot.description import load_description

PARKING = load_course("parking")
BURGER, HUSKY = load_description("turtlebot3-burger"), load_description("husky-a200")


def with_limits(robot, **limits):
    return robot.model_copy(update={"motion": robot.motion.model_copy(update=limits)})


@pytest.mark.parametrize(
    "robot",
    [
        BURGER,
        with_limits(HUSKY, omega_max=0.2),
        pytest.param(with_limits(BURGER, v_max=0.05, omega_max=0.1), marks=pytest.mark.long),
    ],
)
def test_a_slow_robot_can_catch_up_with_its_reference_as_in_the_training(robot):
    course, said = slowed(PARKING, robot)
    v, omega = np.abs(plan_reference(course).motion).max(axis=0)
    assert v * COMMAND_MAX.v / V_MAX <= robot.motion.v_max * 1.01
    assert omega * COMMAND_MAX.omega / OMEGA_MAX <= robot.motion.omega_max * 1.01
    assert course.goal == PARKING.goal
    assert robot.name in said


def test_a_robot_that_is_fast_enough_drives_the_course_as_it_is():
    assert slowed(PARKING, load_description("turtlebot4")) == (PARKING, "")


def test_a_robot_that_would_take_hours_is_refused():
    with pytest.raises(ConfigError, match=r"course parking, .* times as long: .*horizon_s"):
        slowed(PARKING, with_limits(BURGER, v_max=0.001))
