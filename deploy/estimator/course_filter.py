"""The rover's pose on its course: dead reckoning whose errors are states, corrected by external poses.

Rules of this file:

1. Odometry moves the rover from one of its samples to the next. Its errors (scale of distance and of turns,
   wheels that differ, drift of the heading) are estimated beside the pose. A gyro measures the turn of the
   same step, apart from its bias.
2. An external pose belongs to the moment at which it was measured. A late one is inserted into a short
   history, and later measurements are applied again. One that is newer than odometry waits.
3. A pose is accepted or rejected once, when it is first evaluated: by its normalised
   innovation squared (NIS).

State: x, y, θ in the course's frame, the turn δ of the last step, and the errors of odometry: ``scale`` of
distances, ``skid`` of turns, ``pull`` in rad per m, ``drift`` in rad/s; then the gyro's ``bias`` in rad/s.
Without poses and gyro all errors stay 0 and the pose is odometry's own.
"""

import math
from bisect import bisect_right, insort
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter
from numpy.typing import NDArray

from deploy.estimator.settings import EstimatorSettings, Outcome
from rover_ncp.core.geometry import Pose, compose, relative, wrap_angle

X, Y, THETA, TURN, SCALE, SKID, PULL, DRIFT, BIAS = range(9)
SIZE = 9
POSE = slice(X, TURN)
WAITING_MAX = 100
"""Most poses that wait for odometry; with more than this, their stamps are wrong."""

Array = NDArray[np.float64]


class Moment(NamedTuple):
    """The base's measurements at ``t``: its odometry, and the angle of its gyro (rad; NaN without)."""

    t: float
    odometry: Pose
    gyro_rad: float = math.nan


class Seen(NamedTuple):
    """An external pose (x, y, θ) with its covariance (3, 3), measured at ``t``."""

    t: float
    z: Array
    noise: Array


@dataclass(frozen=True, eq=False)
class _Entry:
    """A moment of the history: the measurement, and the state after it."""

    moment: Moment
    seen: Seen | None
    x: Array
    P: Array


class _Filter(ExtendedKalmanFilter):  # type: ignore[misc]  # filterpy ships no types
    """filterpy's EKF; the motion is worked out beside its Jacobian."""

    x: Array
    moved: Array

    def predict_x(self, u: Any = 0) -> None:  # filterpy's signature
        self.x = self.moved


class CourseFilter:
    """Begins at ``pose`` (course frame) with its covariance (3, 3), at a moment of odometry."""

    def __init__(self, settings: EstimatorSettings, pose: Pose, covariance: Array, moment: Moment) -> None:
        s = self._settings = settings
        self._ekf: Any = _Filter(dim_x=SIZE, dim_z=3)
        x = np.zeros(SIZE)
        x[POSE] = pose.x, pose.y, wrap_angle(pose.theta)
        errors = [s.distance_scale, s.turn_scale, s.imbalance_rad_m, s.drift_rad_s, s.gyro_bias_rad_s]
        P = np.diag([0.0] * 4 + [error**2 for error in errors])
        P[POSE, POSE] = covariance
        self._resolution = np.diag([s.position_m**2, s.position_m**2, s.heading_rad**2])
        self._history = [_Entry(moment, None, x, P)]
        self._fresh = 1
        """Number of entries that include all earlier ones. The others are applied again when needed, so many
        late poses at once cost little more than one."""
        self._waiting: list[Seen] = []

    @property
    def moment(self) -> Moment:
        """The newest moment that was taken in."""
        return self._history[-1].moment

    def odometry(self, moment: Moment) -> list[Outcome]:
        """Move to a later moment; return the outcomes of the poses that waited for it."""
        self._apply_again(len(self._history))
        self._history.append(self._entered(self._history[-1], moment, None))
        self._fresh += 1
        due = bisect_right(self._waiting, moment.t, key=lambda seen: seen.t)
        outcomes = [self._insert(seen) for seen in self._waiting[:due]]
        del self._waiting[:due]
        oldest = moment.t - self._settings.history_s
        # The last entry before the window stays: it is where a pose at the window's edge starts from.
        keep = max(bisect_right(self._history, oldest, key=lambda entry: entry.moment.t) - 1, 0)
        self._apply_again(keep + 1)
        del self._history[:keep]
        self._fresh -= keep
        return outcomes

    def pose(self, seen: Seen) -> Outcome:
        """Apply an external pose at its moment, unless it is rejected."""
        if seen.t > self.moment.t:
            if len(self._waiting) >= WAITING_MAX:
                return Outcome.TOO_OLD
            insort(self._waiting, seen, key=lambda other: other.t)
            return Outcome.WAITING
        if seen.t < self._history[0].moment.t:
            return Outcome.TOO_OLD
        return self._insert(seen)

    def at(self, moment: Moment) -> tuple[Array, Array]:
        """Return state (9,) and covariance (9, 9) at a later moment; changes nothing."""
        self._apply_again(len(self._history))
        last = self._history[-1]
        moved, jacobian, noise = self._step(last.x, *_way(last.moment, moment))
        return moved, jacobian @ last.P @ jacobian.T + noise

    def _insert(self, seen: Seen) -> Outcome:
        place = bisect_right(self._history, seen.t, key=lambda entry: entry.moment.t)
        self._apply_again(place)
        before, newest = self._history[place - 1], place == len(self._history)
        between = before.moment if newest else _between(before.moment, self._history[place].moment, seen.t)
        predicted = self._entered(before, between, None)
        innovation = _residual(seen.z, predicted.x[POSE])
        white = np.linalg.solve(np.linalg.cholesky(predicted.P[POSE, POSE] + seen.noise), innovation)
        nis = float(white @ white)
        if not nis <= self._settings.pose_gate:
            return Outcome.OUTLIER
        self._history.insert(place, self._entered(before, between, seen))
        self._fresh = place + 1
        return Outcome.ACCEPTED

    def _apply_again(self, count: int) -> None:
        """Bring the first ``count`` entries up to date."""
        for place in range(self._fresh, count):
            entry = self._history[place]
            self._history[place] = self._entered(self._history[place - 1], entry.moment, entry.seen)
        self._fresh = max(self._fresh, count)

    def _entered(self, before: _Entry, moment: Moment, seen: Seen | None) -> _Entry:
        """Return the entry that follows ``before`` at ``moment``, with what was seen then."""
        ekf = self._ekf
        ekf.x, ekf.P = before.x, before.P
        ekf.moved, ekf.F, ekf.Q = self._step(before.x, *_way(before.moment, moment))
        ekf.predict()
        turned, dt = moment.gyro_rad - before.moment.gyro_rad, moment.t - before.moment.t
        if math.isfinite(turned) and dt > 0:
            H = np.zeros((1, SIZE))
            H[0, TURN], H[0, BIAS] = 1.0, dt
            R = np.array([[self._settings.gyro_rad**2]])
            ekf.update(np.array([turned]), lambda _: H, lambda x: H @ x, R=R)
        if seen is not None:
            H = np.eye(SIZE)[POSE]
            ekf.update(seen.z, lambda _: H, lambda x: x[POSE], R=seen.noise, residual=_residual)
        ekf.x[THETA] = wrap_angle(ekf.x[THETA])
        return _Entry(moment, seen, ekf.x.copy(), ekf.P.copy())

    def seen(self, pose: Pose, covariance: Array, t: float) -> Seen:
        """Return an external pose as it is evaluated: odometry's resolution adds to its covariance."""
        return Seen(t, np.array(pose), covariance + self._resolution)

    def _step(self, x: Array, way: Pose, dt: float) -> tuple[Array, Array, Array]:
        """Return the state after a step, its Jacobian and its process noise.

        ``way`` is the step as odometry saw it, in the rover's frame at its start. Its chord points half a
        turn ahead; what odometry missed of the turn turns the chord by half of that.
        """
        s = self._settings
        ahead, left, turn = way
        delta = (1.0 + x[SKID]) * turn + x[PULL] * ahead + x[DRIFT] * dt
        heading = x[THETA] + 0.5 * (delta - turn)
        cos, sin = math.cos(heading), math.sin(heading)
        chord = np.array([cos * ahead - sin * left, sin * ahead + cos * left])
        shift = (1.0 + x[SCALE]) * chord
        moved = x.copy()
        moved[:THETA] += shift
        moved[THETA] = wrap_angle(x[THETA] + delta)
        moved[TURN] = delta
        across = np.array([-shift[1], shift[0]])
        by_delta = np.array([0.5 * across[0], 0.5 * across[1], 1.0, 1.0])
        jacobian = np.eye(SIZE)
        jacobian[:THETA, THETA] = across
        jacobian[:THETA, SCALE] = chord
        jacobian[TURN, TURN] = 0.0
        for error, share in ((SKID, turn), (PULL, ahead), (DRIFT, dt)):
            jacobian[: TURN + 1, error] = share * by_delta
        noise = np.zeros((SIZE, SIZE))
        length = math.hypot(ahead, left)
        turn_variance = s.wander_rad**2 * length + s.skid_rad**2 * abs(turn)
        noise[: TURN + 1, : TURN + 1] = turn_variance * np.outer(by_delta, by_delta)
        noise[X, X] += s.wander_m**2 * length
        noise[Y, Y] += s.wander_m**2 * length
        return moved, jacobian, noise


def _way(a: Moment, b: Moment) -> tuple[Pose, float]:
    return relative(a.odometry, b.odometry), b.t - a.t


def _between(a: Moment, b: Moment, t: float) -> Moment:
    """Return the moment at ``t`` between two, as if the base had moved evenly."""
    part = (t - a.t) / (b.t - a.t) if b.t > a.t else 0.0
    way = Pose(*(part * number for number in relative(a.odometry, b.odometry)))
    return Moment(t, compose(a.odometry, way), a.gyro_rad + part * (b.gyro_rad - a.gyro_rad))


def _residual(z: Sequence[float] | Array, expected: Array) -> Array:
    """Return measured minus expected pose, the heading's difference within (−π, π]."""
    difference: Array = np.asarray(z) - expected
    difference[THETA] = wrap_angle(difference[THETA])
    return difference
