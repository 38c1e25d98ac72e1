"""Courses for robots that are slower than the one that the shipped courses were made for."""

from rover_ncp.course.course import Course
from rover_ncp.course.reference import COMMAND_MAX
from rover_ncp.robot.description import RobotDescription


def slowed(course: Course, robot: RobotDescription) -> tuple[Course, str]:
    """Return a course slowed down for a robot, and a line that reports it; "" if nothing changed.

    The robot must reach the fastest command of a circuit that follows the reference, or it could not catch
    up. Raises ConfigError for a robot that would take more than an hour.
    """
    motion, slower = robot.motion, slowdown(robot)
    if slower <= 1.0:
        return course, ""
    slower = rounded_up(slower)
    return course.scaled(1.0, slower), (
        f"{course.name} takes {slower:g} times as long for {robot.name}: it reaches {motion.v_max:g} m/s and "
        f"{motion.omega_max:g} rad/s, a circuit commands up to {COMMAND_MAX.v:g} and {COMMAND_MAX.omega:g}"
    )


def slowdown(robot: RobotDescription) -> float:
    """Return how many times slower a course must be for a robot; up to 1 if it is fast enough."""
    return max(COMMAND_MAX.v / robot.motion.v_max, COMMAND_MAX.omega / robot.motion.omega_max)


def rounded_up(factor: float) -> float:
    """Return a factor rounded up to three decimals."""
    scale = 1000.0
    return -(-factor * scale // 1) / scale
