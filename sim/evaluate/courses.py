"""The courses of an evaluation, fitted to its robot."""

from rover_ncp.core.robot_description import RobotDescription, load_description
from rover_ncp.course.course import Course, load_course
from rover_ncp.course.fit import enlarged, slowed
from sim.evaluate.commands import EvalOptions
from sim.evaluate.evaluate import unseen_courses

_SHOWN = 5
"""Of the lines about courses; random ones may be many."""


def fitted_courses(options: EvalOptions) -> tuple[list[Course], RobotDescription | None, list[str]]:
    """Return the courses, the robot if one is named, and lines that say what was changed for it."""
    if options.random_courses:
        courses = unseen_courses(options.seed, options.random_courses)
    else:
        courses = [load_course(name) for name in options.courses]
    if options.model is None:
        return courses, None, []
    robot, changes = load_description(options.model), list[str]()
    for place, course in enumerate(courses):
        larger, size = enlarged(course, robot)
        courses[place], pace = slowed(larger, robot)
        changes += filter(None, (size, pace))
    more = [f"and {len(changes) - _SHOWN} more courses"] if len(changes) > _SHOWN else []
    return courses, robot, changes[:_SHOWN] + more
