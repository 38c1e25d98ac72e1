"""Motion of a skid-steered rover and of its odometry, with Jacobian and process noise.

State: the pose x, y, θ in the course's frame; the pose in odometry's own frame; the encoders' speed v and
turn rate ω; the gyro's turn since its last comparison; then errors of odometry and of the sensors:

    DISTANCE        true distance over odometry's
    GAIN            gyro's turn over odometry's; a skid-steered robot with weight off its middle turns more
    WHEEL_MISMATCH  turn per distance beside the encoders', rad/m
    CENTER          lateral velocity over turn rate, m: distance of the centre of rotation behind the middle
    ASIDE           speed beside the encoders' over turn rate, m: its distance to the left of the middle
    DOWNHILL        slide over turned angle, m/rad, in x and y of the course's frame: on a slope, turning
                    tyres slide and gravity moves the robot
    BIAS            bias of the gyro, rad/s
    GYRO            true turn over the gyro's; only external poses show it
    DELAY           delay of the external poses, s, beyond their stamps
    LASTING         error of the external poses that lasts for seconds, in x, y and θ of their frame: a
                    first-order Gauss-Markov process, which is stationary
    MOUNT           constant error of the external poses' heading, rad, as by the yaw of a camera's mount:
                    θ is the heading as they show it, the rover drives in the direction θ − MOUNT

v and ω are constant but for white noise of the accelerations; one tick at the base's full acceleration
(0.31 m/s², 1.25 rad/s²) is one standard deviation. So the filter follows odometry almost without delay. While
the rover stands, only odometry's own pose may change, and the heading by a disturbance that a gyro shows.
Errors of odometry grow with distance and turn.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from deploy.estimator.settings import EstimatorSettings
from rover_ncp.core.geometry import Pose, compose, wrap_angle

X, Y, THETA, OWN_X, OWN_Y, OWN_THETA, V, OMEGA, TURN = range(9)
DISTANCE, GAIN, WHEEL_MISMATCH, CENTER, ASIDE, DOWN_X, DOWN_Y, BIAS, GYRO, DELAY = range(9, 19)
LASTING, MOUNT = slice(19, 22), 22
SIZE = 23
POSE, OWN, MOTION = slice(X, THETA + 1), slice(OWN_X, OWN_THETA + 1), slice(V, OMEGA + 1)
XY, DOWNHILL = slice(X, Y + 1), slice(DOWN_X, DOWN_Y + 1)

Array = NDArray[np.float64]

_UNIT = np.eye(SIZE)
_OWN_DIAGONAL = 2 * (range(OWN_X, OWN_THETA + 1),)
_LASTING_DIAGONAL = 2 * (range(LASTING.start, LASTING.stop),)

STANDING_SHARE = 0.01
"""Process noise of odometry's own pose while the rover stands, as a share of that on the way."""


class Step(NamedTuple):
    """The state after a step (23,), its Jacobian and the covariance of its process noise (23, 23)."""

    x: Array
    jacobian: Array
    covariance: Array


def initial(
    settings: EstimatorSettings, own: Pose, pose: Pose, covariance: Array | None
) -> tuple[Array, Array]:
    """Return state and covariance of a rover that stands at a ``pose`` (course frame).

    ``own`` is the pose in odometry's own frame. ``covariance`` (3, 3) is that of the noise of external poses,
    of which ``pose`` is the mean: it has their lasting error. Without a covariance the pose is exact.
    """
    s = settings
    x, deviations = np.zeros(SIZE), np.zeros(SIZE)
    x[POSE] = pose.x, pose.y, wrap_angle(pose.theta)
    x[OWN] = own.x, own.y, wrap_angle(own.theta)
    slide = compose(Pose(0.0, 0.0, pose.theta), Pose(s.downhill_x_m, s.downhill_y_m, 0.0))
    x[DOWNHILL] = slide.x, slide.y
    x[[DISTANCE, GAIN, WHEEL_MISMATCH, CENTER, ASIDE, GYRO, DELAY]] = (
        s.distance_gain,
        s.turn_gain,
        s.wheel_mismatch_rad_m,
        s.rotation_center_m,
        s.rotation_center_left_m,
        1.0,
        s.pose_delay_s,
    )
    deviations[OWN] = s.position_m, s.position_m, s.heading_rad
    deviations[DISTANCE : LASTING.start] = (
        s.distance_gain_std,
        s.turn_gain_std,
        s.wheel_mismatch_std_rad_m,
        s.rotation_center_std_m,
        s.rotation_center_left_std_m,
        s.downhill_std_m,
        s.downhill_std_m,
        s.gyro_bias_std_rad_s,
        s.gyro_scale_std,
        s.pose_delay_std_s,
    )
    deviations[MOUNT] = s.mount_std_rad
    P = np.diag(np.square(deviations))
    P[LASTING, LASTING] = lasting = np.diag(lasting_variances(settings))
    if covariance is not None:
        P[POSE, POSE] = covariance + lasting
        P[POSE, LASTING] = P[LASTING, POSE] = -lasting
    return x, P


def lasting_variances(settings: EstimatorSettings) -> Array:
    """Return the variances (3,) of the external poses' lasting error in x, y and θ."""
    return np.square([settings.lasting_m, settings.lasting_m, settings.lasting_rad])


def true_motion(x: Array, settings: EstimatorSettings) -> tuple[float, float, float]:
    """Return the true speed ahead and to the left (m/s) and the turn rate (rad/s)."""
    v, omega = float(x[V]), float(x[OMEGA])
    turn = float(x[GYRO] * (x[GAIN] * turned_without_gain(omega, settings)[0] + x[WHEEL_MISMATCH] * v))
    return float(x[DISTANCE]) * v + float(x[ASIDE]) * turn, float(x[CENTER]) * turn, turn


def standing(x: Array, dt: float, settings: EstimatorSettings, *, new_turn: bool) -> Step:
    """Return the step of a rover that stands for ``dt`` s; a ``new_turn`` begins at 0."""
    moved, jacobian, covariance = x.copy(), _UNIT.copy(), np.zeros((SIZE, SIZE))
    for row in (V, OMEGA, TURN) if new_turn else (V, OMEGA):
        moved[row] = jacobian[row, row] = 0.0
    covariance[_OWN_DIAGONAL] = STANDING_SHARE * settings.slip * dt
    covariance[X, X] = covariance[Y, Y] = dt * (settings.creep_m * settings.creep_m)
    covariance[THETA, THETA] = dt * (settings.creep_rad * settings.creep_rad)
    covariance[TURN, TURN] = covariance[TURN, THETA] = covariance[THETA, TURN] = covariance[THETA, THETA]
    covariance[BIAS, BIAS] = settings.gyro_bias_walk_rad_s**2 * dt
    return _forgetting(Step(moved, jacobian, covariance), dt, settings)


def moving(x: Array, dt: float, settings: EstimatorSettings, *, new_turn: bool) -> Step:
    """Return the step of a moving rover by the midpoint rule; a ``new_turn`` begins at 0."""
    s = settings
    v, omega = float(x[V]), float(x[OMEGA])
    ahead, left, turn = (rate * dt for rate in true_motion(x, s))
    moved, jacobian = x.copy(), _UNIT.copy()
    if new_turn:
        moved[TURN] = jacobian[TURN, TURN] = 0.0
    # Columns: the derivatives of all poses by distance and turn of the encoders, and by the gyro's turn.
    by_distance, by_turn, by_mismatch = np.zeros((3, SIZE))
    own = x[OWN_THETA] + 0.5 * omega * dt
    c, z = math.cos(own), math.sin(own)
    by_distance[OWN_X], by_distance[OWN_Y] = c, z
    by_turn[OWN] = -0.5 * v * dt * z, 0.5 * v * dt * c, 1.0
    moved[OWN_X], moved[OWN_Y] = x[OWN_X] + v * dt * c, x[OWN_Y] + v * dt * z
    moved[OWN_THETA] = wrap_angle(x[OWN_THETA] + omega * dt)
    jacobian[OWN_X, OWN_THETA], jacobian[OWN_Y, OWN_THETA] = -v * dt * z, v * dt * c

    heading = x[THETA] - x[MOUNT] + 0.5 * turn
    cos, sin = math.cos(heading), math.sin(heading)
    dx, dy = cos * ahead - sin * left, sin * ahead + cos * left
    scale, gain, mismatch, center, aside, _, _, _, gyro = x[DISTANCE:DELAY].tolist()
    downhill = x[DOWNHILL]
    moved[XY] += np.array([dx, dy]) + abs(turn) * downhill
    moved[THETA] = wrap_angle(x[THETA] + turn)
    moved[TURN] += turn / gyro
    jacobian[XY, THETA], jacobian[XY, MOUNT] = (-dy, dx), (dy, -dx)
    by_mismatch[POSE] = (
        -0.5 * dy + aside * cos - center * sin,
        0.5 * dx + aside * sin + center * cos,
        1.0,
    )
    by_mismatch[XY] += math.copysign(1.0, turn) * downhill
    jacobian[:, GYRO] += turn / gyro * by_mismatch
    by_mismatch *= gyro
    by_mismatch[TURN] = 1.0
    by_distance += mismatch * by_mismatch
    by_distance[X], by_distance[Y] = by_distance[X] + scale * cos, by_distance[Y] + scale * sin
    turned, by_omega = turned_without_gain(omega, s)
    by_turn += gain * by_omega * by_mismatch
    jacobian[:, V] += dt * by_distance
    jacobian[:, OMEGA] += dt * by_turn
    jacobian[X, DISTANCE], jacobian[Y, DISTANCE] = v * dt * cos, v * dt * sin
    jacobian[X, CENTER], jacobian[Y, CENTER] = -turn * sin, turn * cos
    jacobian[X, ASIDE], jacobian[Y, ASIDE] = turn * cos, turn * sin
    jacobian[X, DOWN_X] = jacobian[Y, DOWN_Y] = abs(turn)
    jacobian[:, GAIN] += turned * dt * by_mismatch
    jacobian[:, WHEEL_MISMATCH] += v * dt * by_mismatch

    noise = np.zeros((SIZE, 11))
    noise[:, :4] = _acceleration_noise(by_distance, by_turn, dt, s)
    slip = math.sqrt(s.slip * dt)
    noise[[OWN_X, OWN_Y, X, Y], 4] = slip * c, slip * z, slip * cos, slip * sin
    noise[[OWN_X, OWN_Y, X, Y], 5] = -slip * z, slip * c, -slip * sin, slip * cos
    length, angle = abs(scale * v * dt), abs(turn)
    noise[X, 6] = noise[Y, 7] = math.sqrt(s.wander_m**2 * length + s.skid_m**2 * angle)
    noise[:, 8] = math.sqrt(s.wander_rad**2 * length + s.skid_rad**2 * angle) * by_mismatch
    noise[GAIN, 9], noise[BIAS, 10] = (
        s.turn_gain_walk * math.sqrt(angle),
        s.gyro_bias_walk_rad_s * math.sqrt(dt),
    )
    return _forgetting(Step(moved, jacobian, noise @ noise.T), dt, s)


def _forgetting(step: Step, dt: float, settings: EstimatorSettings) -> Step:
    """Let the external poses' lasting error change for ``dt`` s, and return it. Its variance stays."""
    kept = math.exp(-dt / settings.lasting_s)
    step.x[LASTING] *= kept
    step.jacobian[_LASTING_DIAGONAL] = kept
    step.covariance[_LASTING_DIAGONAL] = (1.0 - kept * kept) * lasting_variances(settings)
    return step


def turned_without_gain(omega: float, settings: EstimatorSettings) -> tuple[float, float]:
    """Return the true turn rate over the turn gain, without wheel mismatch, and its derivative by ω."""
    # Odometry's turn rate over its scale is the true one · (1 − asymmetry · its sign) + slip · the true one².
    without_slip = 1.0 - settings.turn_asymmetry * math.copysign(1.0, omega)
    root = math.sqrt(without_slip**2 + 4.0 * settings.slip_s * abs(omega))
    return 2.0 * omega / (without_slip + root), 1.0 / root


def _acceleration_noise(by_distance: Array, by_turn: Array, dt: float, settings: EstimatorSettings) -> Array:
    """Return the effects (23, 4) of white accelerations on speeds and poses, which are correlated."""
    noise = np.zeros((SIZE, 4))
    densities = settings.acceleration, settings.angular_acceleration
    for column, (by, rate) in enumerate(((by_distance, V), (by_turn, OMEGA))):
        root = math.sqrt(densities[column] * dt)
        noise[:, 2 * column] = root * dt / math.sqrt(3.0) * by
        noise[rate, 2 * column : 2 * column + 2] = root * math.sqrt(3.0) / 2.0, root / 2.0
    return noise
