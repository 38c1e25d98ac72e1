"""The extended Kalman filter: prediction by the rover's motion, and the effect of each measurement."""

import math
from typing import Any

import numpy as np

from deploy.estimator.extended_kalman import ExtendedKalmanFilter
from deploy.estimator.inputs import (
    Disturbance,
    LongerErrors,
    Odometry,
    PoseMeasurement,
    Turn,
    irregular_covariance,
    normalised_square,
    residual,
)
from deploy.estimator.motion import (
    ASIDE,
    CENTER,
    DELAY,
    GYRO,
    LASTING,
    MOTION,
    MOUNT,
    OWN,
    POSE,
    SIZE,
    THETA,
    TURN,
    Array,
    moving,
    standing,
    true_motion,
)
from deploy.estimator.settings import EstimatorSettings
from rover_ncp.core.geometry import wrap_angle

_ALL = np.eye(SIZE)
CENTERS = (CENTER, ASIDE)
_BLOCKS = (OWN, MOTION)
"""Odometry's pose and motion have independent errors and are applied one after the other: a 5 × 5 inverse
would use scipy's threads, 50 ms on a busy machine."""

Measured = Odometry | PoseMeasurement | Disturbance | LongerErrors


class Filter(ExtendedKalmanFilter):  # type: ignore[misc]  # filterpy ships no types
    """filterpy's filter at one moment: state ``x`` (23,) and covariance ``P`` (23, 23)."""

    x: Array
    P: Array

    def __init__(self, settings: EstimatorSettings) -> None:
        super().__init__(dim_x=SIZE, dim_z=5)
        self.settings = s = settings
        deviations = [s.position_m, s.position_m, s.heading_rad, s.speed_m_s, s.turn_rad_s]
        self.odometry_covariance = np.diag(np.square(deviations))

    def predict_x(self, u: Any = 0) -> None:  # filterpy's signature
        """Set the state that the model of the motion predicts, which filterpy calls."""
        self.x = self._moved

    def bring(self, x: Array, P: Array, dt: float, *, stood: bool, new_turn: bool) -> None:
        """Predict from a state and its covariance over ``dt`` s."""
        self.x, self.P = x, P
        step = standing if stood else moving
        self._moved, self.F, self.Q = step(x, dt, self.settings, new_turn=new_turn)
        self.predict()

    def apply(self, measured: Measured, stood: bool) -> None:
        """Apply a measurement of the moment that the filter is at; ``stood``: the rover stood before it."""
        match measured:
            case PoseMeasurement():
                self.correct(*self.innovation(measured), measured.covariance)
            case Disturbance():
                self.P[POSE, POSE] += measured.covariance
            case LongerErrors():
                # The start had such an error, too, and it has changed since then.
                self.P[POSE, POSE] += measured.covariance
                self.P[LASTING, LASTING] += 2.0 * measured.covariance
                self.P[POSE, LASTING] -= measured.covariance
                self.P[LASTING, POSE] -= measured.covariance
            case Odometry():
                self.correct_by_odometry(measured.z, stood, measured.irregular)
                if measured.turn is not None:
                    self.correct_by_turn(measured.turn)

    def copies(self) -> tuple[Array, Array]:
        """Return copies of state and covariance, with angles within (−π, π]."""
        for angle in (THETA, OWN.stop - 1):
            self.x[angle] = wrap_angle(self.x[angle])
        return self.x.copy(), self.P.copy()

    def _irregular_covariance(self) -> Array:
        """Return the covariance (3, 3) of a pose of irregular odometry."""
        return irregular_covariance(self.odometry_covariance[:3, :3], *self.x[MOTION])

    def pose_fits(self, z: Array) -> bool:
        """Return whether the pose of irregular odometry fits; the filter is predicted to its time."""
        covariance = self.P[OWN, OWN] + self._irregular_covariance()
        return self.passes(residual(z[:3], self.x[OWN]), covariance)

    def correct_by_odometry(self, z: Array, stood: bool, irregular: bool) -> None:
        """Apply odometry (5,); if it is ``irregular``, its pose alone."""
        if irregular:
            self.correct(residual(z[:3], self.x[OWN]), _ALL[OWN], self._irregular_covariance())
            return
        for rows in _BLOCKS:
            part = slice(rows.start - OWN.start, rows.stop - OWN.start)
            if not (stood and rows is MOTION):
                self.correct(
                    residual(z[part], self.x[rows]), _ALL[rows], self.odometry_covariance[part, part]
                )

    def correct_by_turn(self, turn: Turn) -> None:
        """Apply the turn of a gyro."""
        self.P[np.ix_((THETA, TURN), (THETA, TURN))] += turn.disturbance_variance
        if turn.gain_variance:
            by_gain = turn.by_gain(float(self.x[GYRO]))
            self.P += turn.gain_variance * np.outer(by_gain, by_gain)
        H = turn.row
        self.correct(turn.angle - H @ self.x, H, np.array([[turn.variance]]))
        self.P[CENTERS, CENTERS] += turn.center_variances

    def passes(self, innovation: Array, covariance: Array) -> bool:
        """Return whether an external pose passes the gate by its innovation and the covariance of that."""
        return normalised_square(innovation, covariance) <= self.settings.pose_gate

    def correct(self, innovation: Array, H: Array, covariance: Array) -> None:
        """Apply a measurement by its innovation, its Jacobian and the covariance of its noise."""
        self.update(innovation, lambda _: H, lambda _: 0.0, R=covariance)

    def expected(self, measured: PoseMeasurement) -> tuple[Array, Array]:
        """Return an external pose's innovation (3,) and the covariance (3, 3) of that."""
        innovation, H = self.innovation(measured)
        return innovation, H @ self.P @ H.T + measured.covariance

    def innovation(self, measured: PoseMeasurement) -> tuple[Array, Array]:
        """Return an external pose's innovation (3,) and its Jacobian (3, 23).

        The pose was measured at its stamp minus the delay, and the rover went on until the entry's time.
        """
        x = self.x
        ahead, left, turn = true_motion(x, self.settings)
        direction = x[THETA] - x[MOUNT]
        cos, sin = math.cos(direction), math.sin(direction)
        velocity = np.array([cos * ahead - sin * left, sin * ahead + cos * left, turn])
        H = _ALL[POSE] + _ALL[LASTING]
        H[:, DELAY] = -velocity
        expected = x[POSE] + x[LASTING]
        return residual(measured.z - (measured.assumed_delay_s - x[DELAY]) * velocity, expected), H
