"""Errors of one trial between command, motion and odometry.

The plain rollout calls these functions. ``rover_ncp/native/episode.cpp`` repeats them in C++ with the same
bits.
"""

import math
from typing import NamedTuple

from rover_ncp.core.geometry import Pose
from rover_ncp.course.course import TICK_S
from sim.world.randomization import Trials


class BaseErrors(NamedTuple):
    """Errors between command and motion; gains, rad/m, s; of the motors m/s, rad/s, m, a share."""

    gain_v: float
    gain_omega: float
    wheel_mismatch: float
    slip: float
    dead_band_v: float = 0.0
    dead_band_omega: float = 0.0
    wheel_min: float = 0.0
    slow_wheel: float = 0.0
    half_track: float = 1.0
    stiction: float = 0.0


class OdometryErrors(NamedTuple):
    """Errors between motion and odometry; scales, rad/m, s, rad/s, gain, m."""

    distance_scale: float
    heading_scale: float
    wheel_mismatch: float
    slip: float
    drift: float
    turn_gain: float = 1.0
    rotation_center: float = 0.0


def quantise(value: float, step: float) -> float:
    """Return the nearest whole multiple of ``step``; the value itself if that is 0."""
    return value if step == 0.0 else step * math.floor(value / step + 0.5)


def push_tick(share: float, ticks: int) -> int:
    """Return the tick at whose start a push comes, after a share of all ticks."""
    return math.floor(share * ticks)


def base_errors(trials: Trials, row: int) -> BaseErrors:
    """Return the errors of a trial's base."""
    gain_v, gain_omega = float(trials.gain[row, 0]), float(trials.gain[row, 1])
    motors = trials.motors[row]
    return BaseErrors(
        gain_v,
        gain_omega,
        float(trials.wheel_mismatch[row]),
        float(trials.slip[row]),
        float(motors[0]),
        float(motors[1]),
        float(motors[2]),
        float(motors[3]),
        float(motors[4]),
        float(motors[5]),
    )


def odometry_errors(trials: Trials, row: int) -> OdometryErrors:
    """Return the errors of the odometry that a trial's sensors make."""
    scale, drift, center = trials.odometry[row, 0], trials.drift[row], trials.turning[row, 1]
    heading_scale, wheel_mismatch, slip, turn_gain = 1.0, 0.0, 0.0, 1.0
    if not trials.sensors[0]:
        heading_scale, turn_gain = float(trials.odometry[row, 1]), float(trials.turning[row, 0])
        wheel_mismatch, slip = float(trials.wheel_mismatch[row]), float(trials.slip[row])
    return OdometryErrors(
        float(scale), heading_scale, wheel_mismatch, slip, float(drift), turn_gain, float(center)
    )


def apply_base_errors(
    v: float, omega: float, base: BaseErrors, before: tuple[float, float]
) -> tuple[float, float]:
    """Return what a base makes of a command (m/s, rad/s): the motion it then accelerates to.

    ``before`` is what it made of the last command. A speed within the dead band counts as 0; by stiction, the
    band of a base that moved before is narrower. Then each wheel that is slower than the least speed stands
    or turns at its speed for slow wheels.
    """
    kinetic = 1.0 - base.stiction
    if abs(v) < base.dead_band_v * (1.0 if before[0] == 0.0 else kinetic):
        v = 0.0
    if abs(omega) < base.dead_band_omega * (1.0 if before[1] == 0.0 else kinetic):
        omega = 0.0
    if base.wheel_min > 0.0:
        left, right = v - omega * base.half_track, v + omega * base.half_track
        if abs(left) < base.wheel_min:
            left = 0.0 if left == 0.0 else math.copysign(base.slow_wheel, left)
        if abs(right) < base.wheel_min:
            right = 0.0 if right == 0.0 else math.copysign(base.slow_wheel, right)
        v, omega = 0.5 * (left + right), 0.5 * (right - left) / base.half_track
    forward, turn = base.gain_v * v, base.gain_omega * omega
    return forward, turn * (1.0 - base.slip * abs(turn)) + base.wheel_mismatch * forward


def dead_reckon(believed: Pose, before: Pose, after: Pose, errors: OdometryErrors) -> Pose:
    """Return where odometry believes to be after a tick, its heading not wrapped.

    It measures the motion of the centre of rotation, which does not slide, in the rover's frame: distances
    and turn with their scales, the turn by the wheels, with what slipped away and without what no encoder
    sees. True headings are within (−π, π].
    """
    dx, dy = after.x - before.x, after.y - before.y
    cos, sin = math.cos(before.theta), math.sin(before.theta)
    turn = after.theta - before.theta
    if turn > math.pi:
        turn -= math.tau
    elif turn <= -math.pi:
        turn += math.tau
    # To the second order of a tick's turn, less than 0.1 rad.
    ahead = errors.distance_scale * (cos * dx + sin * dy + 0.5 * errors.rotation_center * turn * turn)
    left = errors.distance_scale * (cos * dy - sin * dx - errors.rotation_center * turn) / errors.turn_gain
    turn /= errors.turn_gain
    turn = turn * (1.0 + errors.slip * abs(turn) / TICK_S) - errors.wheel_mismatch * ahead
    cos, sin = math.cos(believed.theta), math.sin(believed.theta)
    return Pose(
        believed.x + cos * ahead - sin * left,
        believed.y + sin * ahead + cos * left,
        believed.theta + (errors.heading_scale * turn + errors.drift * TICK_S),
    )
