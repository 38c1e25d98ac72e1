"""A short excitation drive: steps forward and back, left and right, with pauses, and two slow ramps.

Rules of this file:

1. It stays within a circle around its start. If the rover could leave the circle, or if odometry does not
   show that it drives, the drive ends.
2. It stops for the same reasons as a drive: `SafetyMonitor` checks before each command, and every exit
   releases the lease.
3. Steps are whole mm/s and deg/s, which a Pioneer takes unchanged. Their duration is no whole number of
   reports, so that reports fall on all parts of a ramp.
"""

import math
import time
from collections.abc import Callable, Iterator
from itertools import chain
from typing import NamedTuple

from deploy.drive.link import Link
from deploy.drive.measurements import Measurements
from deploy.drive.safety_monitor import FOLLOWED_MIN, SafetyMonitor
from rover_ncp.core.errors import SafetyStop
from rover_ncp.core.geometry import STANDSTILL, Pose, Velocity, compose, distance, relative
from rover_ncp.core.process import Clock
from rover_ncp.robot.description import RobotDescription
from rover_ncp.wire.messages import OdometrySample

FENCE_M = 0.8
"""How far from its start the rover may come; the steps take it half as far."""
PERIOD_S = 0.05
BRAKE_M_S2, REACT_S = 0.2, 0.4
"""Minimum deceleration of a base and its maximum delay, for the fence."""

_SPEEDS_M_S = (0.150, -0.150, 0.200, -0.200, 0.100, -0.100)
_DRIVE_S, _REST_S = 2.13, 2.06
_TURNS_DEG_S = (10, -10, 20, -20, 28, -28)
_TURN_S, _TURN_REST_S = 2.13, 1.86
_BEFORE_S, _AFTER_S = 0.6, 0.6


RAMP = Velocity(0.005, 0.02)
"""First speed of the ramps that measure the dead band, and their steps."""
RAMP_STEPS = 20
LEVEL_S = 0.65
"""Time at each speed of a ramp, longer than a base's delay and acceleration."""
PATIENCE = 4
"""The first speed is held up to so many times as long: soft tyres wind up before they turn the rover."""
MIN_WAY_M, MIN_WAY_RAD = 0.1, 0.2
"""Of steps that odometry must show: a straight one at least in part, as a turn may be within a dead band."""
FOLLOWED = 0.5, 1.5
"""Reported speed over command of a robot that follows a command."""


DeadBands = tuple[float | None, float | None]
"""The least speed command and the least turn command that a robot follows; None if it follows none."""


class Step(NamedTuple):
    """A velocity, and for how long (s)."""

    velocity: Velocity
    seconds: float


def steps(robot: RobotDescription | None = None) -> list[Step]:
    """Return the steps, 51 s, at speeds that the robot reaches."""
    v_share = min(1.0, robot.motion.v_max / max(_SPEEDS_M_S)) if robot else 1.0
    turn_share = min(1.0, robot.motion.omega_max / math.radians(max(_TURNS_DEG_S))) if robot else 1.0
    rest = STANDSTILL
    found = [Step(rest, _BEFORE_S)]
    for v in _SPEEDS_M_S:
        found += [Step(Velocity(v_share * v, 0.0), _DRIVE_S), Step(rest, _REST_S)]
    for turn in _TURNS_DEG_S:
        omega = turn_share * math.radians(turn)
        found += [Step(Velocity(0.0, omega), _TURN_S), Step(rest, _TURN_REST_S)]
    return [*found, Step(rest, _AFTER_S)]


def excite(
    link: Link,
    measurements: Measurements,
    monitor: SafetyMonitor,
    fence_m: float,
    clock: Clock = time,
    *,
    robot: RobotDescription | None = None,
    begin: Callable[[], None] = lambda: None,
) -> DeadBands:
    """Drive the steps, after ``monitor.wait``, and return the dead bands; the lease is always released.

    ``begin`` is called when it is granted.

    Raises SafetyStop (``geofence``, or a rule of the monitor), KeyboardInterrupt, or the errors of
    ``Link.request_motors``.
    """
    assert measurements.newest is not None  # the monitor waited for odometry
    start, ramps = measurements.newest.sample.pose, Ramps(measurements)
    try:
        link.request_motors("identify")
        monitor.granted()
        begin()
        due = clock.monotonic()
        for step in chain(steps(robot), ramps):
            end, began = due + step.seconds, measurements.newest.sample.pose
            while due < end:
                monitor.check()
                _check_fence(measurements.newest.sample, start, fence_m)
                link.command(step.velocity)
                due = min(due + PERIOD_S, end)
                while (left_s := due - clock.monotonic()) > 0.0:
                    measurements.odometry(left_s)
            _check_response(step, relative(began, measurements.newest.sample.pose))
    finally:
        link.release()
    return ramps.dead_bands


def follows(reported: float, command: float) -> bool:
    """Return whether a reported speed is that of a robot that follows a command other than 0."""
    return FOLLOWED[0] < reported / command < FOLLOWED[1]


class Ramps:
    """Slow steps on each axis, each a little faster, until the robot follows one."""

    def __init__(self, measurements: Measurements) -> None:
        self._measurements = measurements
        self.followed: list[float | None] = [None, None]
        """The slowest step of each axis that the robot followed, in m/s and rad/s; None before one."""

    def __iter__(self) -> Iterator[Step]:
        for axis, unit in enumerate((Velocity(RAMP.v, 0.0), Velocity(0.0, RAMP.omega))):
            for number in [1] * PATIENCE + [*range(2, RAMP_STEPS + 1)]:
                velocity = Velocity(number * unit.v, number * unit.omega)
                yield Step(velocity, LEVEL_S)
                newest = self._measurements.newest
                if newest is not None and follows(newest.sample.velocity[axis], velocity[axis]):
                    self.followed[axis] = velocity[axis]
                    break
            yield Step(STANDSTILL, _AFTER_S)

    @property
    def dead_bands(self) -> DeadBands:
        """The dead band of each axis; 0 for a robot that follows the slowest step."""
        v, omega = (0.0 if each == least else each for each, least in zip(self.followed, RAMP, strict=True))
        return v, omega


def _check_response(step: Step, moved: Pose) -> None:
    """Raise SafetyStop when odometry hardly shows a straight step, or shows a step the other way round.

    Without odometry the fence would not hold either.
    """
    (v, omega), seconds = step
    way_m, way_rad = abs(v) * seconds, abs(omega) * seconds
    driven_m, turned_rad = moved.x * math.copysign(1.0, v), moved.theta * math.copysign(1.0, omega)
    if way_m >= MIN_WAY_M and driven_m < FOLLOWED_MIN * way_m:
        words = f"drove {driven_m:.3f} m where {way_m:.3f} m were commanded"
    elif way_rad >= MIN_WAY_RAD and turned_rad < -FOLLOWED_MIN * way_rad:
        words = f"turned by {turned_rad:.3f} rad where {way_rad:.3f} rad were commanded"
    else:
        return
    raise SafetyStop("no-response", f"by odometry the rover {words}")


def _check_fence(odometry: OdometrySample, start: Pose, fence_m: float) -> None:
    """Raise SafetyStop when the rover would come to stand beyond the fence."""
    v = odometry.velocity.v
    stop = compose(odometry.pose, Pose(v * REACT_S + v * abs(v) / (2.0 * BRAKE_M_S2), 0.0, 0.0))
    # Each by itself: a comparison with NaN is false, and the larger of a number and NaN may be the number.
    if not all(distance(pose, start) <= fence_m for pose in (odometry.pose, stop)):
        raise SafetyStop("geofence", f"the rover would come farther than {fence_m} m from its start")
