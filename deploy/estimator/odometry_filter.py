"""Motion of the base by its own odometry: an extended Kalman filter with a gate before it.

The state is (x, y, θ, v, ω) in odometry's frame. Between measurements v and ω are constant apart from white
noise in the two accelerations. One tick at the base's full acceleration (0.31 m/s², 1.25 rad/s²) is one
standard deviation of that noise. Encoders resolve 1 mm and 0.09°, far finer than that. So the filter follows
odometry almost without lag, bridges missing samples, and rejects impossible ones. A circuit that was trained
on exact poses must not get late ones.
"""

import math
from typing import Any

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter
from numpy.typing import NDArray

from deploy.estimator.settings import EstimatorSettings, Outcome
from rover_ncp.core.geometry import Pose, Velocity, wrap_angle

X, Y, THETA, V, OMEGA = range(5)

BLOCKS = (slice(X, V), slice(V, OMEGA + 1))
"""Pose and motion are applied one after the other, which is equivalent, as their errors are independent.
Together they would need a 5 × 5 inverse, for which scipy uses threads: 50 ms on a busy machine."""

Array = NDArray[np.float64]


class _Filter(ExtendedKalmanFilter):  # type: ignore[misc]  # filterpy ships no types
    """filterpy's EKF with the unicycle as its motion."""

    x: Array
    dt = 0.0

    def predict_x(self, u: Any = 0) -> None:  # filterpy's signature
        self.x = _moved(self.x, self.dt)


class OdometryFilter:
    """At rest at ``pose`` at time ``t`` to begin with."""

    def __init__(self, settings: EstimatorSettings, pose: Pose, t: float) -> None:
        s = self._settings = settings
        deviations = [s.position_m, s.position_m, s.heading_rad, s.speed_m_s, s.turn_rad_s]
        self._noise = np.diag(np.square(deviations))
        self._filter: Any = _Filter(dim_x=5, dim_z=5)
        self._filter.x = np.array([pose.x, pose.y, wrap_angle(pose.theta), 0.0, 0.0])
        self._filter.P = self._noise.copy()
        self.t = t
        """Of the last evaluated measurement."""

    @property
    def pose(self) -> Pose:
        """The pose in odometry's frame at ``t``."""
        x, y, theta = self._filter.x[:V].tolist()
        return Pose(x, y, theta)

    def measure(self, pose: Pose, velocity: Velocity, t: float) -> Outcome:
        """Apply an odometry sample of ``t``, unless it is rejected."""
        z = np.array([*pose, *velocity])
        if not (np.isfinite(z).all() and math.isfinite(t)):
            return Outcome.NOT_FINITE
        if t < self.t:
            return Outcome.OUT_OF_ORDER
        ekf = self._filter
        self._predict(t)
        innovation = _residual(z, ekf.x)
        # A sum of squares is never negative: absurd values give infinity or NaN, which are rejected below.
        with np.errstate(over="ignore", invalid="ignore"):
            white = np.linalg.solve(np.linalg.cholesky(ekf.P + self._noise), innovation)
            nis = float(white @ white)
        if not nis <= self._settings.gate:
            return Outcome.OUTLIER
        for rows in BLOCKS:
            self._correct(z, rows)
        return Outcome.ACCEPTED

    def at(self, t: float) -> tuple[Pose, Velocity, Array]:
        """Return pose, motion and covariance (5, 5), predicted to ``t``; not before the last measurement."""
        ekf, dt = self._filter, t - self.t
        if dt < 0:
            raise ValueError(f"asked for {t} s, which is before the last measurement at {self.t} s")
        x, jacobian = _moved(ekf.x, dt), _jacobian(ekf.x, dt)
        covariance = jacobian @ ekf.P @ jacobian.T + self._process_noise(ekf.x, dt)
        pose = Pose(float(x[X]), float(x[Y]), float(x[THETA]))
        return pose, Velocity(float(x[V]), float(x[OMEGA])), covariance

    def _correct(self, z: Array, rows: slice) -> None:
        """Apply some rows of a measurement of the whole state."""

        def residual(measured: Array, expected: Array) -> Array:
            return _residual(measured, expected)[rows]

        ekf = self._filter
        ekf.update(z, lambda _: np.eye(5)[rows], lambda x: x, R=self._noise[rows, rows], residual=residual)
        ekf.x[THETA] = wrap_angle(ekf.x[THETA])

    def _predict(self, t: float) -> None:
        ekf, dt = self._filter, t - self.t
        ekf.F, ekf.Q = _jacobian(ekf.x, dt), self._process_noise(ekf.x, dt)
        ekf.dt = dt
        ekf.predict()
        self.t = t

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
