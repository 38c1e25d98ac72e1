"""The courses of an evaluation, fitted to its robot."""

from typing import Any

from rover_ncp.core.files import DEFAULT_ROBOT
from rover_ncp.course.course import Course, load_course
from rover_ncp.course.fit import rounded_up, slowed
from rover_ncp.robot.description import RobotDescription, load_description
from sim.evaluate.commands import EvalOptions
from sim.evaluate.evaluate import unseen_courses

_SHOWN = 5
"""Of the lines about courses; random ones may be many."""


def fitted_courses(options: EvalOptions) -> tuple[list[Course], RobotDescription | None, dict[str, Any]]:
    """Return the courses, the robot if one is named, and what the result says of both."""
    if options.random_courses:
        courses = unseen_courses(options.seed, options.random_courses)
    else:
        courses = [load_course(name) for name in options.courses]
    robot = None if options.model is None else load_description(options.model)
    changes: list[str] = []
    for place, course in enumerate(courses):
        if robot is not None:
            larger, size = _enlarged(course, robot)
            courses[place], pace = slowed(larger, robot)
            changes += filter(None, (size, pace))
    more = [f"and {len(changes) - _SHOWN} more courses"] if len(changes) > _SHOWN else []
    return courses, robot, {"model": options.model, "scaled": changes[:_SHOWN] + more}


def _enlarged(course: Course, robot: RobotDescription) -> tuple[Course, str]:
    """Return a course with obstacles enlarged for a robot, and a line that reports it; "" if nothing changed.

    Speeds stay, so a larger course takes longer.
    """
    usual = load_description(DEFAULT_ROBOT)
    larger = max(_reach(robot) / _reach(usual), robot.width_m / usual.width_m)
    if not course.obstacles or larger <= 1.0:
        return course, ""
    larger = rounded_up(larger)
    return course.scaled(larger, 1.0), (
        f"{course.name} is {larger:g} times as large for {robot.name}, {robot.length_m:g} m by "
        f"{robot.width_m:g} m, and takes {larger:g} times as long"
    )


def _reach(robot: RobotDescription) -> float:
    """Return how far the outline reaches from the centre of rotation, before or behind it."""
    return max(robot.front_m, robot.rear_m)
