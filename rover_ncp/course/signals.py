"""The signals that a policy observes by name, the same numbers in the simulator and on the robot.

A new signal is a row of ``TABLE`` and a value in ``signals``. ``episode.cpp`` of the native library repeats
this function, the exported C takes the expression of the row, and the reference page its meaning.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

from rover_ncp.core.geometry import Pose, Velocity


class Signal(NamedTuple):
    """One row of the table."""

    name: str
    meaning: str
    c: str
    """C expression of the value in ``export/templates/policy.c``."""
    from_reference: bool = False
    """Whether it needs the course's reference."""


TABLE = (
    Signal("x", "m, the rover's pose in the course's frame", "x"),
    Signal("y", "m, the rover's pose in the course's frame", "y"),
    Signal("theta", "rad, the rover's heading in the course's frame", "theta"),
    Signal("start", "0 or 1, the start signal", "course->tick >= {start_tick} ? R(1.0) : R(0.0)"),
    Signal("longitudinal", "m that the reference is ahead of the rover", "cosine * dx + sine * dy", True),
    Signal("lateral", "m that the reference is to the rover's left", "cosine * dy - sine * dx", True),
    Signal("heading", "rad from the rover's heading to the reference's, left positive", "turned", True),
    Signal("speed", "m/s, the reference's forward speed", "course->v", True),
    Signal("turn", "rad/s, the reference's turn rate, left positive", "course->omega", True),
)
SIGNALS = tuple(signal.name for signal in TABLE)
REFERENCE_SIGNALS = tuple(signal.name for signal in TABLE if signal.from_reference)


def unknown_signals(names: Sequence[str]) -> list[str]:
    """Return the problem of names that are no signals, in a list; empty if there are none."""
    unknown = [name for name in names if name not in SIGNALS]
    known = ", ".join(SIGNALS)
    return [f"unknown signals: {', '.join(unknown)} (expected some of {known})"] if unknown else []


def needs_reference(names: tuple[str, ...]) -> bool:
    """Whether any of these signals comes from the reference."""
    return any(name in REFERENCE_SIGNALS for name in names)


def signals(pose: Pose, start: float, reference: tuple[Pose, Velocity] | None) -> tuple[float, ...]:
    """Return all signals, in the order of ``SIGNALS``; without a reference its signals are 0."""
    if reference is None:
        return (pose.x, pose.y, pose.theta, start, 0.0, 0.0, 0.0, 0.0, 0.0)
    where, motion = reference
    dx, dy = where.x - pose.x, where.y - pose.y
    cos, sin = math.cos(pose.theta), math.sin(pose.theta)
    turned = where.theta - pose.theta
    if turned > math.pi:
        turned -= math.tau
    elif turned <= -math.pi:
        turned += math.tau
    longitudinal, lateral = cos * dx + sin * dy, cos * dy - sin * dx
    return (
        pose.x,
        pose.y,
        pose.theta,
        start,
        longitudinal,
        lateral,
        turned,
        motion.v,
        motion.omega,
    )
