"""The filter with its recent measurements, so that a late external pose is applied at its own moment.

Rules of this file:

1. An external pose belongs to the moment at which it was measured. A late one is inserted into a short
   history, and later measurements are applied again. One that is newer than odometry waits.
2. A measurement is accepted or rejected once, when it is first evaluated: by its normalised innovation
   squared (NIS).
3. A pose that is refused while the rover moves may mean that something pushed it, such as a cable that it
   drove over. If a push explains the pose, the covariance grows by one, once until a pose is accepted. The
   estimate stays, and the next pose can correct it. A rover that was carried away was moved by more.
4. The rover stands between two odometry samples that report no motion at all and the same place. Its pose
   then stays the same, and noise does not move the estimate.
"""

import math
from bisect import bisect_right, insort
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter

from deploy.estimator.motion import (
    BIAS,
    DELAY,
    MOTION,
    OWN,
    POSE,
    SIZE,
    THETA,
    TURN,
    Array,
    initial,
    moving,
    standing,
    true_motion,
)
from deploy.estimator.settings import EstimatorSettings, Outcome
from rover_ncp.core.geometry import Pose, wrap_angle

WAITING_MAX = 100
"""Most poses that wait for odometry; with more than this, their stamps are wrong."""
REST_M_S, REST_RAD_S = 0.0005, 0.001
"""Slower motion counts as none: less than half a step of what a base reports."""
SAME_PLACE = 5.0
"""Poses within so many standard deviations of odometry's noise count as the same place."""

_ALL = np.eye(SIZE)
REPORTED = slice(OWN.start, MOTION.stop)
_BLOCKS = (OWN, MOTION)
"""Odometry's pose and motion are applied one after the other, which is equivalent, as their errors are
independent. A 5 × 5 inverse for both would use scipy's threads: 50 ms on a busy machine."""


class Odometry(NamedTuple):
    """A sample: pose and motion (5,), and the angle that a gyro turned since the sample before (rad)."""

    z: Array
    turned: float
    """NaN without a gyro."""
    seconds: float
    """Since the sample before."""


class Seen(NamedTuple):
    """An external pose (x, y, θ) with its covariance (3, 3), and its stamp minus the entry's time in s."""

    z: Array
    noise: Array
    late_s: float


class Push(NamedTuple):
    """A push that no sensor of the base sees, by its covariance (3, 3) in x, y, θ."""

    noise: Array


@dataclass(frozen=True, eq=False)
class _Entry:
    """A measurement at ``t`` s, and the state after it."""

    t: float
    stood: bool
    """Whether the rover stood since the entry before."""
    measured: Odometry | Seen | Push
    x: Array
    P: Array


class _Filter(ExtendedKalmanFilter):  # type: ignore[misc]  # filterpy ships no types
    """filterpy's EKF; the motion is worked out beside its Jacobian."""

    x: Array
    moved: Array

    def predict_x(self, u: Any = 0) -> None:  # filterpy's signature
        self.x = self.moved


class History:
    """Begins at rest at ``pose`` (course frame) with its covariance (3, 3), where odometry is at ``own``."""

    def __init__(
        self, settings: EstimatorSettings, t: float, own: Pose, pose: Pose, covariance: Array
    ) -> None:
        s = self._settings = settings
        self._ekf: Any = _Filter(dim_x=SIZE, dim_z=5)
        x, P = initial(s, own, pose)
        P[POSE, POSE] = covariance
        deviations = [s.position_m, s.position_m, s.heading_rad, s.speed_m_s, s.turn_rad_s]
        self._noise = np.diag(np.square(deviations))
        z = np.array([*own, 0.0, 0.0])
        self._entries = [_Entry(t, True, Odometry(z, math.nan, 0.0), x, P)]
        self._fresh = 1
        """Number of entries that include all earlier ones. The others are applied again when needed, so many
        late poses at once cost little more than one."""
        self._waiting: list[tuple[float, Seen]] = []
        self._last = t, z
        """Time and numbers of the newest odometry."""
        self._push = Push(np.diag(np.square([s.push_m, s.push_m, s.push_rad])))
        self._pushed = False
        """Whether the covariance has a push since the last accepted pose."""
        self.nis: dict[bool, tuple[int, float]] = {True: (0, 0.0), False: (0, 0.0)}
        """Number and sum of the NIS of external poses, while the rover stood and while it moved."""

    @property
    def t(self) -> float:
        """The moment of the newest odometry."""
        return self._last[0]

    def odometry(self, z: Array, turned: float, t: float) -> tuple[Outcome, list[Outcome]]:
        """Apply odometry; return its outcome and those of the poses that waited for it."""
        if t < self.t:
            return Outcome.OUT_OF_ORDER, []
        if not self._predicted(z, t)[0] <= self._settings.gate:
            return Outcome.OUTLIER, []
        self._entries.append(self._updated(t, self._stands(z), Odometry(z, turned, t - self.t)))
        self._last = t, z
        self._fresh += 1
        due = bisect_right(self._waiting, t, key=lambda waiting: waiting[0])
        outcomes = [self._insert(*waiting) for waiting in self._waiting[:due]]
        del self._waiting[:due]
        # The last entry before the window stays: it is where a pose at the window's edge starts from.
        oldest = t - self._settings.history_s
        keep = max(bisect_right(self._entries, oldest, key=lambda entry: entry.t) - 1, 0)
        self._apply_again(keep + 1)
        del self._entries[:keep]
        self._fresh -= keep
        return Outcome.ACCEPTED, outcomes

    def misfit(self, z: Array, t: float) -> float:
        """Return −2 log likelihood, but for a constant, of odometry measured at ``t``."""
        if t < self.t:
            return math.inf
        nis, covariance = self._predicted(z, t)
        return nis + float(np.linalg.slogdet(covariance)[1])

    def _predicted(self, z: Array, t: float) -> tuple[float, Array]:
        """Predict the filter to ``t``; return the NIS of odometry there, and its covariance (5, 5)."""
        self._apply_again(len(self._entries))
        self._predict(self._entries[-1], t, self._stands(z))
        covariance = self._ekf.P[REPORTED, REPORTED] + self._noise
        return _nis(_residual(z, self._ekf.x[REPORTED]), covariance), covariance

    def pose(self, z: Array, noise: Array, t: float) -> Outcome:
        """Apply an external pose of stamp ``t`` at its moment, unless it is rejected."""
        begin = self._entries[0].t
        if t < begin:
            return Outcome.TOO_OLD
        at = max(t - max(float(self._entries[self._fresh - 1].x[DELAY]), 0.0), begin)
        seen = Seen(z, noise, t - at)
        if at <= self.t:
            return self._insert(at, seen)
        if len(self._waiting) >= WAITING_MAX:
            return Outcome.TOO_OLD
        insort(self._waiting, (at, seen), key=lambda waiting: waiting[0])
        return Outcome.WAITING

    def at(self, t: float) -> tuple[Array, Array]:
        """Return state (18,) and covariance (18, 18) at ``t``, not before the newest odometry."""
        if t < self.t:
            raise ValueError(f"asked for {t} s, which is before the last measurement at {self.t} s")
        self._apply_again(len(self._entries))
        last = self._entries[-1]
        x, jacobian, noise = moving(last.x, t - last.t, self._settings, new_turn=True)
        return x, jacobian @ last.P @ jacobian.T + noise

    def _stands(self, z: Array) -> bool:
        """Return whether a sample and the one before report no motion, and the same place."""
        before = self._last[1]
        limits = SAME_PLACE * math.sqrt(2.0) * np.sqrt(np.diag(self._noise)[:3])
        moved = np.abs(_residual(z[:3], before[:3]))
        still = np.abs([z[3:], before[3:]]).max(axis=0) < (REST_M_S, REST_RAD_S)
        return bool(still.all() and (moved < limits).all())

    def _insert(self, t: float, seen: Seen) -> Outcome:
        place = bisect_right(self._entries, t, key=lambda entry: entry.t)
        self._apply_again(place)
        stood = self._entries[min(place, len(self._entries) - 1)].stood
        self._predict(self._entries[place - 1], t, stood)
        innovation, H = self._innovation(seen)
        covariance = H @ self._ekf.P @ H.T + seen.noise
        nis = _nis(innovation, covariance)
        accepted = nis <= self._settings.pose_gate
        if accepted:
            count, total = self.nis[stood]
            self.nis[stood] = count + 1, total + nis
        push = not (accepted or stood or self._pushed) and (
            _nis(innovation, covariance + self._push.noise) <= self._settings.pose_gate
        )
        if accepted or push:
            self._entries.insert(place, self._updated(t, stood, seen if accepted else self._push))
            self._fresh = place + 1
        self._pushed = push or (self._pushed and not accepted)
        return Outcome.ACCEPTED if accepted else Outcome.OUTLIER

    def _apply_again(self, count: int) -> None:
        """Bring the first ``count`` entries up to date."""
        for place in range(self._fresh, count):
            entry = self._entries[place]
            self._predict(self._entries[place - 1], entry.t, entry.stood)
            self._entries[place] = self._updated(entry.t, entry.stood, entry.measured)
        self._fresh = max(self._fresh, count)

    def _predict(self, before: _Entry, t: float, stood: bool) -> None:
        """Bring the filter from an entry to time ``t``."""
        ekf, dt = self._ekf, t - before.t
        ekf.x, ekf.P = before.x, before.P
        if stood:
            ekf.moved, ekf.F, ekf.Q = standing(before.x, dt, self._settings)
        else:
            new_turn = isinstance(before.measured, Odometry)
            ekf.moved, ekf.F, ekf.Q = moving(before.x, dt, self._settings, new_turn=new_turn)
        ekf.predict()

    def _updated(self, t: float, stood: bool, measured: Odometry | Seen | Push) -> _Entry:
        """Apply a measurement to the filter, which is at its time; return its entry."""
        ekf = self._ekf
        if isinstance(measured, Seen):
            innovation, H = self._innovation(measured)
            self._correct(innovation, H, measured.noise)
        elif isinstance(measured, Push):
            ekf.P[POSE, POSE] += measured.noise
        else:
            for rows in _BLOCKS:
                part = slice(rows.start - OWN.start, rows.stop - OWN.start)
                if not (stood and rows is MOTION):
                    innovation = _residual(measured.z[part], ekf.x[rows])
                    self._correct(innovation, _ALL[rows], self._noise[part, part])
            if math.isfinite(measured.turned) and measured.seconds > 0:
                H = _ALL[TURN : TURN + 1] + measured.seconds * _ALL[BIAS : BIAS + 1]
                noise = np.array([[self._settings.gyro_rad**2]])
                self._correct(measured.turned - H @ ekf.x, H, noise)
        for angle in (THETA, OWN.stop - 1):
            ekf.x[angle] = wrap_angle(ekf.x[angle])
        return _Entry(t, stood, measured, ekf.x.copy(), ekf.P.copy())

    def _correct(self, innovation: Array, H: Array, noise: Array) -> None:
        self._ekf.update(innovation, lambda _: H, lambda _: 0.0, R=noise)

    def _innovation(self, seen: Seen) -> tuple[Array, Array]:
        """Return an external pose's innovation (3,) and its Jacobian (3, 18).

        The pose was measured at its stamp minus the delay, and the rover went on until the entry's time.
        """
        x = self._ekf.x
        ahead, left, turn = true_motion(x, self._settings)
        cos, sin = math.cos(x[THETA]), math.sin(x[THETA])
        velocity = np.array([cos * ahead - sin * left, sin * ahead + cos * left, turn])
        H = _ALL[POSE].copy()
        H[:, DELAY] = -velocity
        return _residual(seen.z - (seen.late_s - x[DELAY]) * velocity, x[POSE]), H


def _residual(z: Array, expected: Array) -> Array:
    """Return measured minus expected values; the third, if there is one, is an angle within (−π, π]."""
    difference = z - expected
    if len(difference) > THETA:
        difference[THETA] = wrap_angle(difference[THETA])
    return difference


def _nis(innovation: Array, covariance: Array) -> float:
    """Return the normalised innovation squared."""
    # A sum of squares is never negative: absurd values give infinity or NaN, which no gate accepts.
    with np.errstate(over="ignore", invalid="ignore"):
        white = np.linalg.solve(np.linalg.cholesky(covariance), innovation)
        return float(white @ white)
