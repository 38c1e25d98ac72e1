"""What the filter is given, how far it is from what was expected, and what becomes of it."""

import math
from enum import Enum
from typing import NamedTuple

import numpy as np

from deploy.estimator.motion import BIAS, GAIN, SIZE, THETA, TURN, Array
from deploy.estimator.settings import EstimatorSettings
from rover_ncp.core.geometry import wrap_angle

STAMP_STD_S = 0.02
"""Standard deviation of the stamps of irregular odometry: robots report poses of other moments than these."""
COARSE_STD_RAD = 0.0018
"""Standard deviation of a heading in steps of 0.35°, which some robots send."""

REST_M_S, REST_RAD_S = 0.0005, 0.001
"""Slower motion counts as none: less than half a step of a Pioneer's rounding."""
MEMORY = 0.9
"""Weight of an innovation in `Whiteness`, against the next."""
WHITE_NIS = 25.0
"""Largest normalised square of white innovations' sum: 1 in 60,000 of a χ² with 3 degrees."""
STILL_SIGMAS = 5.0
"""Limit for no motion between two samples, in standard deviations of odometry's noise."""


class Acceptance(Enum):
    """Whether a measurement was accepted, or why not."""

    ACCEPTED = "accepted"
    OUTLIER = "outlier"
    NOT_FINITE = "not finite"
    OUT_OF_ORDER = "out of order"
    WAITING = "newer than odometry, which it waits for"
    TOO_OLD = "too old"
    DROPPED = "too many poses wait for odometry"
    REPEATED = "the same pose again, although odometry moved"


class GyroAngle(NamedTuple):
    """Angle (rad, from any zero) that a gyro has turned at ``t`` s; NaN where it is not known."""

    rad: float
    t: float


class Turn(NamedTuple):
    """Angle (rad) that a gyro turned in some seconds, its variance, and that of a disturbance.

    The newest reading may be older than odometry. ``ahead`` is how much more odometry had turned since then
    at the turn's end than at its begin, before the turn gain, rad. ``turned`` is all that odometry turned,
    before the turn gain, rad.
    """

    angle: float
    seconds: float
    ahead: float
    turned: float
    variance: float
    disturbance_variance: float = 0.0
    gain_variance: float = 0.0
    """Of a change of the turn gain before this turn, as on another floor."""
    center_variances: tuple[float, float] = (0.0, 0.0)
    """Of the change of the centre of rotation that goes with it: behind, and to the left, m²."""

    @property
    def row(self) -> Array:
        """The Jacobian (1, 23) of the angle."""
        row = np.zeros((1, SIZE))
        row[0, [TURN, BIAS, GAIN]] = 1.0, self.seconds, -self.ahead
        return row

    def by_gain(self, gyro_scale: float) -> Array:
        """Return the derivative (23,) of the state by the turn gain of this turn."""
        column = np.zeros(SIZE)
        column[[GAIN, TURN, THETA]] = 1.0, self.turned, gyro_scale * self.turned
        return column


class Odometry(NamedTuple):
    """A sample: pose and motion (5,), whether a turn ends with it, and that turn if a gyro showed it."""

    z: Array
    ends_turn: bool = True
    turn: Turn | None = None
    irregular: bool = False


class Applied(NamedTuple):
    """What became of an odometry sample, of its gyro's turn (None without), and of the poses that waited."""

    odometry: Acceptance
    turn: Acceptance | None = None
    poses: tuple[Acceptance, ...] = ()


class PoseMeasurement(NamedTuple):
    """An external pose (x, y, θ) with its covariance (3, 3), and its stamp minus the entry's time in s."""

    z: Array
    covariance: Array
    assumed_delay_s: float


class Disturbance(NamedTuple):
    """A motion that no sensor of the base reports, by its covariance (3, 3) in x, y, θ."""

    covariance: Array


class LongerErrors(NamedTuple):
    """A larger lasting error of the external poses than assumed: its added covariance (3, 3) in x, y, θ."""

    covariance: Array


class Whiteness:
    """Tells whether the errors of external poses last longer than the filter assumes.

    Innovations of a consistent filter are white (Mehra, 1970). Their normalised sum, in which each counts a
    tenth less than the next, is compared with the χ² distribution. One outlier does not pass the limit.
    """

    def __init__(self) -> None:
        self._sum = np.zeros(3)

    def passes(self, white: Array, largest: float) -> bool:
        """Add a `whitened` innovation, whose norm counts at most ``largest``; return whether it is white."""
        with np.errstate(over="ignore", invalid="ignore"):
            norm = float(np.linalg.norm(white))
        if math.isfinite(norm):
            self._sum = MEMORY * self._sum + white * min(1.0, largest / max(norm, largest))
        passed = (1.0 - MEMORY**2) * float(self._sum @ self._sum) <= WHITE_NIS
        if not passed:
            self._sum = np.zeros(3)
        return passed


def residual(z: Array, expected: Array) -> Array:
    """Return measured minus expected values; the third, if there is one, is an angle within (−π, π]."""
    difference = z - expected
    if len(difference) > THETA:
        difference[THETA] = wrap_angle(difference[THETA])
    return difference


def whitened(innovation: Array, covariance: Array) -> Array:
    """Return an innovation in units of its standard deviations, along independent directions."""
    with np.errstate(over="ignore", invalid="ignore"):
        return np.linalg.solve(np.linalg.cholesky(covariance), innovation)


def normalised_square(innovation: Array, covariance: Array) -> float:
    """Return the normalised innovation squared."""
    return squared(whitened(innovation, covariance))


def squared(white: Array) -> float:
    """Return the square of a `whitened` innovation."""
    # A sum of squares is never negative: absurd values give infinity or NaN, which no gate accepts.
    with np.errstate(over="ignore", invalid="ignore"):
        return float(white @ white)


class StillLimits(NamedTuple):
    """Limits of motion for a rover that stands: change of x, y (m) and θ (rad), v in m/s, ω in rad/s."""

    position_m: float
    heading_rad: float
    v: float
    omega: float


def still_limits(settings: EstimatorSettings) -> StillLimits:
    """Return the limits by the noise of odometry; the default noise of its speeds is below them."""
    s, default = settings, EstimatorSettings()
    change = STILL_SIGMAS * math.sqrt(2.0)
    v = math.sqrt(max(s.speed_m_s**2 - default.speed_m_s**2, 0.0))
    omega = math.sqrt(max(s.turn_rad_s**2 - default.turn_rad_s**2, 0.0))
    return StillLimits(
        change * s.position_m,
        change * s.heading_rad,
        REST_M_S + STILL_SIGMAS * v,
        REST_RAD_S + STILL_SIGMAS * omega,
    )


def stands(before: Array, after: Array, limits: StillLimits) -> bool:
    """Return whether two samples of odometry (5,) report no motion, and the same place."""
    # In plain floats: numpy takes ten times as long, which each command would wait for.
    x_0, y_0, theta_0, v_0, omega_0 = before.tolist()
    x_1, y_1, theta_1, v_1, omega_1 = after.tolist()
    return (
        max(abs(x_1 - x_0), abs(y_1 - y_0)) < limits.position_m
        and abs(wrap_angle(theta_1 - theta_0)) < limits.heading_rad
        and max(abs(v_0), abs(v_1)) < limits.v
        and max(abs(omega_0), abs(omega_1)) < limits.omega
    )


def irregular_covariance(covariance: Array, v: float, omega: float) -> Array:
    """Add the noise of irregular odometry at v (m/s) and omega (rad/s) to a pose's covariance (3, 3)."""
    late_m, late_rad = STAMP_STD_S * v, STAMP_STD_S * omega
    added: Array = np.diag(np.square([late_m, late_m, math.hypot(late_rad, COARSE_STD_RAD)]))
    return covariance + added
