"""Courses for robots that are slower than the one that the shipped courses were made for."""

import math

from rover_ncp.course.course import Course
from rover_ncp.course.reference import COMMAND_MAX
from rover_ncp.robot.description import RobotDescription


def slowed(course: Course, robot: RobotDescription) -> tuple[Course, str]:
    """Return a course slowed down for a robot, and a line that reports it; "" if nothing changed.

    The robot must reach `COMMAND_MAX` (0.24 m/s, 0.36 rad/s), the fastest command of a circuit, so that it
    can catch up. The reference itself keeps the limits of the paper's motors (0.16 m/s, 0.18 rad/s). Raises
    ConfigError for a robot that would take more than an hour.
    """
    motion, slower = robot.motion, slowdown(robot)
    if slower <= 1.0:
        return course, ""
    slower = rounded_up(slower)
    return course.scaled(size=1.0, slower=slower), (
        f"{course.name} takes {slower:g} times as long for {robot.name}: {robot.name} reaches "
        f"{motion.v_max:g} m/s and {motion.omega_max:g} rad/s, circuits command up to {COMMAND_MAX.v:g} and "
        f"{COMMAND_MAX.omega:g}"
    )


def slowdown(robot: RobotDescription) -> float:
    """Return how many times slower a course must be for a robot; at most 1 if the robot is fast enough."""
    return max(COMMAND_MAX.v / robot.motion.v_max, COMMAND_MAX.omega / robot.motion.omega_max)


def rounded_up(factor: float) -> float:
    """Return a factor rounded up to three decimals."""
    return math.ceil(factor * 1000.0) / 1000.0
