"""Quantities that a policy can observe, by name: the same numbers in the simulator and on the robot.

    x, y, theta                       the rover's pose in the course's frame, m and rad
    start                             the start signal, 0 or 1
    longitudinal, lateral, heading    where the moving reference is, seen from the rover: m ahead, m to the
                                      left, rad to the left
    speed, turn                       the reference's motion, m/s and rad/s

A signal of the reference needs a course's reference; the others do not.
"""

import math

from rover_ncp.core.geometry import Pose, Velocity

REFERENCE_SIGNALS = ("longitudinal", "lateral", "heading", "speed", "turn")
SIGNALS = ("x", "y", "theta", "start", *REFERENCE_SIGNALS)
"""In the order of ``see``."""


def needs_reference(names: tuple[str, ...]) -> bool:
    """Whether any of these signals comes from the reference."""
    return any(name in REFERENCE_SIGNALS for name in names)


def seen_from(pose: Pose, reference: Pose) -> Pose:
    """Return the reference's pose in the rover's frame: ahead and to the left in m, turned left in rad.

    Headings are within (−π, π]. Kernels compile this very function: it calls but ``math`` and Pose.
    """
    dx, dy = reference.x - pose.x, reference.y - pose.y
    cos, sin = math.cos(pose.theta), math.sin(pose.theta)
    turned = reference.theta - pose.theta
    if turned > math.pi:
        turned -= math.tau
    elif turned <= -math.pi:
        turned += math.tau
    return Pose(cos * dx + sin * dy, cos * dy - sin * dx, turned)


def see(pose: Pose, start: float, reference: tuple[Pose, Velocity] | None) -> tuple[float, ...]:
    """Return all signals, in the order of ``SIGNALS``; without a reference its signals are 0."""
    if reference is None:
        return (*pose, start, 0.0, 0.0, 0.0, 0.0, 0.0)
    where, motion = reference
    return (*pose, start, *seen_from(pose, where), *motion)
