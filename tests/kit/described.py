"""Robots as their shipped descriptions say, but for some keys."""

from rover_ncp.robot.description import load_description


def described(name, **changed):
    """Return the description of a robot with keys of its parts changed: ``motion={"decel": 1.0}``."""
    robot = load_description(name)
    parts = {}
    for part, keys in changed.items():
        known = getattr(robot, part)
        parts[part] = type(known).model_validate(known.model_dump() | keys)
    return robot.model_copy(update=parts)
