"""Courses for other robots than the one that the shipped ones were made for."""

from rover_ncp.core.files import USUAL_ROBOT
from rover_ncp.course.course import Course
from rover_ncp.course.reference import COMMAND_MAX
from rover_ncp.robot.description import RobotDescription, load_description

_DIGITS = 3


def slowed(course: Course, robot: RobotDescription) -> tuple[Course, str]:
    """Return a course as slow as a robot asks for, and a line that says so; "" if nothing changed.

    The robot must reach the fastest command of a circuit that follows the reference, or it could not catch
    up. Raises ConfigError for a robot that would take more than an hour.
    """
    motion = robot.motion
    slower = max(COMMAND_MAX.v / motion.v_max, COMMAND_MAX.omega / motion.omega_max)
    if slower <= 1.0:
        return course, ""
    slower = _up(slower)
    return course.scaled(1.0, slower), (
        f"{course.name} takes {slower:g} times as long for {robot.name}: it reaches {motion.v_max:g} m/s and "
        f"{motion.omega_max:g} rad/s, a circuit commands up to {COMMAND_MAX.v:g} and {COMMAND_MAX.omega:g}"
    )


def enlarged(course: Course, robot: RobotDescription) -> tuple[Course, str]:
    """Return a course with obstacles as large as a robot asks for, and a line that says so; "" as above.

    Speeds stay: what is larger takes longer.
    """
    usual = load_description(USUAL_ROBOT)
    larger = max(_reach(robot) / _reach(usual), robot.width_m / usual.width_m)
    if not course.obstacles or larger <= 1.0:
        return course, ""
    larger = _up(larger)
    return course.scaled(larger, 1.0), (
        f"{course.name} is {larger:g} times as large for {robot.name}, {robot.length_m:g} m by "
        f"{robot.width_m:g} m, and takes {larger:g} times as long"
    )


def _reach(robot: RobotDescription) -> float:
    """Return how far the outline reaches from the centre of rotation, before or behind it."""
    return max(robot.front_m, robot.rear_m)


def _up(factor: float) -> float:
    """Return a factor rounded up, so that it reads well and is enough."""
    scale = 10.0**_DIGITS
    return -(-factor * scale // 1) / scale
