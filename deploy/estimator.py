"""Where the rover is: an extended Kalman filter over odometry, with a gate before it.

Rules of this file:

1. The filter is seeded once, by `Estimator.start`, and never again. What does not fit is refused; refused
   too often in a row is a fault, which stays.
2. Nothing that is not finite reaches the filter.
3. Asking where the rover is (`Estimator.at`) changes nothing.

The state is (x, y, θ, v, ω) in the course's frame. Between measurements v and ω stay as they are but for
white noise in the two accelerations; the noise is chosen so that one tick at the base's full acceleration
(0.31 m/s², 1.25 rad/s²) is one standard deviation. Encoders resolve 1 mm and 0.09°, far finer than that, so
the filter follows odometry almost without lag, bridges missing samples, and refuses impossible ones: a
circuit trained on exact poses must not be shown late ones.
"""

import math
from dataclasses import dataclass
from enum import Enum
from typing import Any

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter
from numpy.typing import NDArray
from pydantic import Field

from rover_ncp.core.config import StrictModel
from rover_ncp.core.geometry import Pose, Velocity, wrap_angle

__all__ = ["Estimate", "Estimator", "EstimatorSettings", "Outcome"]

X, Y, THETA, V, OMEGA = range(5)

BLOCKS = (slice(X, V), slice(V, OMEGA + 1))
"""Pose and motion are taken in one after the other, which is the same, as their errors are independent.
Together they would need a 5 × 5 inverse, which scipy hands to threads: 50 ms where other processes work."""

Array = NDArray[np.float64]


class EstimatorSettings(StrictModel):
    """Noises and limits of the filter, SI units."""

    position_m: float = Field(default=0.0005, gt=0, description="odometry, position: steps of 1 mm")
    heading_rad: float = Field(default=0.0007, gt=0, description="odometry, heading: steps of 0.09°")
    speed_m_s: float = Field(default=0.003, gt=0, description="odometry, speed: whole mm/s per wheel")
    turn_rad_s: float = Field(default=0.006, gt=0, description="odometry, turn rate: from whole mm/s")
    acceleration: float = Field(default=0.01, gt=0, description="process noise of v in (m/s)²/s")
    angular_acceleration: float = Field(default=0.16, gt=0, description="process noise of ω in (rad/s)²/s")
    slip: float = Field(default=1e-6, gt=0, description="process noise of x and y in m²/s")
    gate: float = Field(default=25.74, gt=0, description="largest NIS: 1 in 10,000 of a χ² with 5 degrees")
    rejected_in_a_row: int = Field(default=3, ge=1, description="so many refused in a row are a fault")


class Outcome(Enum):
    """What became of a measurement."""

    ACCEPTED = "accepted"
    OUTLIER = "outlier"
    NOT_FINITE = "not finite"
    OUT_OF_ORDER = "out of order"


@dataclass(frozen=True)
class Estimate:
    """The rover at ``t`` seconds: pose in the course's frame, motion, covariance of (x, y, θ, v, ω)."""

    t: float
    pose: Pose
    velocity: Velocity
    covariance: Array


class _Filter(ExtendedKalmanFilter):  # type: ignore[misc]  # filterpy ships no types
    """filterpy's EKF with the unicycle as its motion."""

    x: Array
    dt = 0.0

    def predict_x(self, u: Any = 0) -> None:  # filterpy's signature
        self.x = _moved(self.x, self.dt)


class Estimator:
    """The filter with its gate. Times are seconds on one clock, any zero."""

    def __init__(self, settings: EstimatorSettings | None = None) -> None:
        self._settings = settings or EstimatorSettings()
        self._filter: Any = None
        self._t = 0.0
        s = self._settings
        deviations = [s.position_m, s.position_m, s.heading_rad, s.speed_m_s, s.turn_rad_s]
        self._noise = np.diag(np.square(deviations))
        self.nis = 0.0
        """Normalised innovation squared of the last finite measurement."""
        self.rejected = 0
        """Measurements refused so far."""
        self.fault = ""
        """Why the estimate can no longer be trusted; empty while it can."""
        self._in_a_row = 0

    def start(self, pose: Pose, t: float) -> None:
        """Seed the filter, once: the rover stands at ``pose`` (course frame) at time ``t``."""
        if self._filter is not None:
            raise RuntimeError("the estimator is seeded once and never again")
        if not all(map(math.isfinite, (*pose, t))):
            raise ValueError(f"cannot start from {pose} at {t}")
        ekf = _Filter(dim_x=5, dim_z=5)
        ekf.x = np.array([pose.x, pose.y, wrap_angle(pose.theta), 0.0, 0.0])
        ekf.P = self._noise.copy()
        self._filter, self._t = ekf, t

    def odometry(self, pose: Pose, velocity: Velocity, t: float) -> Outcome:
        """Take in odometry measured at ``t``: pose in the course's frame, v in m/s, ω in rad/s."""
        outcome = self._weigh(pose, velocity, t)
        if outcome is Outcome.ACCEPTED:
            self._in_a_row = 0
            return outcome
        self.rejected += 1
        self._in_a_row += 1
        if self._in_a_row >= self._settings.rejected_in_a_row and not self.fault:
            self.fault = f"{self._in_a_row} odometry samples in a row refused, the last as {outcome.value}"
        return outcome

    def _weigh(self, pose: Pose, velocity: Velocity, t: float) -> Outcome:
        z = np.array([*pose, *velocity])
        if not (np.isfinite(z).all() and math.isfinite(t)):
            return Outcome.NOT_FINITE
        if t < self._t:
            return Outcome.OUT_OF_ORDER
        ekf = self._filter
        self._predict(t)
        innovation = _residual(z, ekf.x)
        # As a sum of squares it cannot come out negative: absurd values give infinity or NaN, refused below.
        with np.errstate(over="ignore", invalid="ignore"):
            white = np.linalg.solve(np.linalg.cholesky(ekf.P + self._noise), innovation)
            self.nis = float(white @ white)
        if not self.nis <= self._settings.gate:
            return Outcome.OUTLIER
        for rows in BLOCKS:
            self._correct(z, rows)
        return Outcome.ACCEPTED

    def _correct(self, z: Array, rows: slice) -> None:
        """Take some rows of a measurement of the whole state into the filter."""

        def residual(measured: Array, expected: Array) -> Array:
            return _residual(measured, expected)[rows]

        ekf = self._filter
        ekf.update(z, lambda _: np.eye(5)[rows], lambda x: x, R=self._noise[rows, rows], residual=residual)
        ekf.x[THETA] = wrap_angle(ekf.x[THETA])

    def _predict(self, t: float) -> None:
        ekf, dt = self._filter, t - self._t
        ekf.F, ekf.Q = _jacobian(ekf.x, dt), self._process_noise(ekf.x, dt)
        ekf.dt = dt
        ekf.predict()
        self._t = t

    def at(self, t: float) -> Estimate:
        """Return the estimate predicted to ``t``, which must not lie before the last measurement."""
        ekf, dt = self._filter, t - self._t
        if dt < 0:
            raise ValueError(f"asked for {t} s, which is before the last measurement at {self._t} s")
        x, jacobian = _moved(ekf.x, dt), _jacobian(ekf.x, dt)
        covariance = jacobian @ ekf.P @ jacobian.T + self._process_noise(ekf.x, dt)
        return Estimate(
            t,
            Pose(float(x[X]), float(x[Y]), float(x[THETA])),
            Velocity(float(x[V]), float(x[OMEGA])),
            covariance,
        )

    def _process_noise(self, x: Array, dt: float) -> Array:
        """Return Q of white noise in both accelerations over ``dt``, along the mean heading, plus slip."""
        s = self._settings
        heading = x[THETA] + 0.5 * dt * x[OMEGA]
        along = np.array([math.cos(heading), math.sin(heading)])
        q = np.zeros((5, 5))
        q[:2, :2] = s.acceleration * dt**3 / 3 * np.outer(along, along) + s.slip * dt * np.eye(2)
        q[:2, V] = q[V, :2] = s.acceleration * dt**2 / 2 * along
        q[V, V] = s.acceleration * dt
        q[THETA, THETA] = s.angular_acceleration * dt**3 / 3
        q[THETA, OMEGA] = q[OMEGA, THETA] = s.angular_acceleration * dt**2 / 2
        q[OMEGA, OMEGA] = s.angular_acceleration * dt
        return q


def _moved(x: Array, dt: float) -> Array:
    """Return the state after ``dt`` seconds at constant v and ω, by the midpoint rule."""
    heading = x[THETA] + 0.5 * dt * x[OMEGA]
    return np.array(
        [
            x[X] + dt * x[V] * math.cos(heading),
            x[Y] + dt * x[V] * math.sin(heading),
            wrap_angle(x[THETA] + dt * x[OMEGA]),
            x[V],
            x[OMEGA],
        ]
    )


def _jacobian(x: Array, dt: float) -> Array:
    """Return the derivative of `_moved` by the state."""
    heading = x[THETA] + 0.5 * dt * x[OMEGA]
    c, s = math.cos(heading), math.sin(heading)
    f = np.eye(5)
    f[X, THETA], f[X, V], f[X, OMEGA] = -dt * x[V] * s, dt * c, -0.5 * dt**2 * x[V] * s
    f[Y, THETA], f[Y, V], f[Y, OMEGA] = dt * x[V] * c, dt * s, 0.5 * dt**2 * x[V] * c
    f[THETA, OMEGA] = dt
    return f


def _residual(z: Array, expected: Array) -> Array:
    """Return measured minus expected, the heading's difference within (−π, π]."""
    difference = z - expected
    difference[THETA] = wrap_angle(difference[THETA])
    return difference
