"""Robots as their shipped descriptions say, but for some keys."""

from rover_ncp.robot.description import load_description


def described(name, **changed):
    """Return the description of a robot with keys of its parts changed: ``motion={"decel": 1.0}``."""
    robot = load_description(name)
    parts = {part: getattr(robot, part).model_copy(update=keys) for part, keys in changed.items()}
    return robot.model_copy(update=parts)
