"""Pose estimate from odometry, an optional gyro and optional external poses.

Rules of this file:

1. The filter is seeded once, by `Estimator.start`, and never again. Measurements that do not fit are
   rejected; too many rejections in a row are a fault, which stays.
2. Nothing that is not finite reaches the filter.
3. Reading the estimate (`Estimator.at`) changes nothing.

One extended Kalman filter: `motion` is its model, `history` applies the measurements, also late ones.
"""

import math
from collections import Counter, deque
from dataclasses import dataclass

import numpy as np
from scipy.special import gammaincinv

from deploy.estimator.history import TURN_S, History
from deploy.estimator.inputs import Acceptance, GyroAngle
from deploy.estimator.motion import (
    ASIDE,
    CENTER,
    DISTANCE,
    GAIN,
    GYRO,
    MOUNT,
    OMEGA,
    POSE,
    SIZE,
    WHEEL_MISMATCH,
    Array,
    V,
    lasting_variances,
    true_motion,
    turned_without_gain,
)
from deploy.estimator.settings import GYRO_S, EstimatorSettings
from rover_ncp.core.geometry import ORIGIN, Pose, Velocity, near
from rover_ncp.robot.lasting_error import UNDECLARED, LastingError
from rover_ncp.wire.messages import GYRO_GAP_S, OdometrySample, PoseSample, TurnSample

GYRO_OFF_RAD_S = 1.0
"""A reading with a larger error, beyond five standard deviations of its noise, is rejected."""
LATE, EARLY = 1.5, 0.5
"""Odometry after a gap of more than 1.5 default gaps may be delayed, and the next one after less than 0.5."""
GAPS = 9
MAX_VARIANCE = 1e12
"""Of an external pose, m² and rad²: beyond any that says "not known", and far from overflow."""
REPEATED_M, REPEATED_RAD = 0.03, 0.05
"""A localiser whose pose does not change in the least while odometry moves so far repeats an old one."""
JUDGED_POSES, REJECTED_POSES = 20, 10
"""Among so many external poses, so many rejections are a fault, too."""
GAINS = 0.15, 4.0
"""External poses that need a turn gain beyond these, by two standard deviations, contradict odometry, such as
those of a mirrored frame. Poses late by 0.5 s need one when a rover without a gyro begins to turn."""
ODOMETRY, GYRO_READINGS, POSES = "odometry samples", "gyro readings", "external poses"


@dataclass(frozen=True)
class Estimate:
    """The rover at ``t`` seconds: pose in the course's frame, motion, covariance of (x, y, θ, v, ω)."""

    t: float
    pose: Pose
    velocity: Velocity
    covariance: Array
    turn_gain: float
    """True turn over odometry's."""
    rotation_center_m: float
    """How far the centre of rotation lies behind the middle."""

    @property
    def error_95_m(self) -> float:
        """Position error that 95 % of such estimates do not exceed."""
        # The squared distance is a sum of two scaled χ²; one of the same mean and variance stands for it.
        variances = np.clip(np.linalg.eigvalsh(self.covariance[:2, :2]), 0.0, None)
        total = float(variances.sum())
        if total == 0.0:
            return 0.0
        scale = float(np.square(variances).sum()) / total
        return math.sqrt(2.0 * scale * gammaincinv(0.5 * total / scale, 0.95))


class _Gyro:
    """The angle that a gyro has turned, integrated from its rates."""

    def __init__(self) -> None:
        self._t, self._rad, self._rate = -math.inf, 0.0, 0.0
        self._gap = True

    def measure(self, rate: float, t: float) -> None:
        """Add the mean rate since the previous reading."""
        gap = t - self._t
        if 0.0 <= gap <= GYRO_GAP_S:
            self._rad += rate * gap
        else:
            self._gap = True
        self._t, self._rate = t, rate

    def miss(self) -> None:
        """Record a reading that cannot be used: a gap."""
        self._gap = True

    def angle(self, t: float) -> GyroAngle:
        """Return the angle at ``t``, or at the newest reading if that is older.

        It is NaN where it is unknown, and once after each gap.
        """
        if self._gap or abs(t - self._t) > GYRO_GAP_S:
            self._gap = abs(t - self._t) > GYRO_GAP_S
            return GyroAngle(math.nan, t)
        read = min(t, self._t)
        return GyroAngle(self._rad + self._rate * (read - self._t), read)


class _BurstStamps:
    """Times at which the samples of a burst were due.

    A network that stops for a moment delivers several samples at once, stamped with their arrival.
    """

    def __init__(self) -> None:
        self._gaps: deque[float] = deque(maxlen=GAPS)
        self._t = self._due = math.nan

    def due(self, t: float) -> float:
        """Return the latest time at which the sample of stamp ``t`` was due: ``t``, except in a burst."""
        gap, late = t - self._t, self._due < self._t
        typical = sorted(self._gaps)[GAPS // 2] if len(self._gaps) == GAPS else math.inf
        if not math.isnan(gap):
            self._gaps.append(gap)
        waited = gap > LATE * typical or (late and 0.0 <= gap < EARLY * typical)
        self._t, self._due = t, min(t, self._due + typical) if waited else t
        return self._due


class Estimator:
    """The filter with its faults. Times are seconds on one clock, any zero."""

    def __init__(self, settings: EstimatorSettings | None = None) -> None:
        self._settings = settings or EstimatorSettings()
        self._started: History | None = None
        self._gyro, self._bursts = _Gyro(), _BurstStamps()
        self._gyro_off_rad_s = GYRO_OFF_RAD_S + 5.0 * self._settings.gyro_rad / GYRO_S
        self.rejected = 0
        """Odometry samples rejected so far."""
        self.gyro_rejected = 0
        """Gyro readings rejected so far."""
        self.poses = dict.fromkeys(Acceptance, 0)
        """Counts of external poses by outcome; a waiting pose is counted again when it is evaluated."""
        self.fault = ""
        self.fault_rule = ""
        """The fault of the estimate, empty without one, and its safety rule."""
        self._in_a_row: Counter[str] = Counter()
        """Rejections in a row, by what was rejected."""
        self._gyro_counted = -math.inf
        self._judged: deque[bool] = deque(maxlen=JUDGED_POSES)
        """Of the newest external poses, whether they were rejected."""
        self._corrected = False
        """Whether an external pose was accepted since the turn gain was checked."""
        self._own = ORIGIN
        """The newest pose of odometry, in its own frame."""
        self._changed: tuple[Pose, Pose] | None = None
        """The newest external pose that differed from the one before, and the pose of odometry then."""

    def start(
        self,
        pose: Pose,
        t: float,
        odometry: Pose | None = None,
        covariance: Array | None = None,
        lasting: LastingError = UNDECLARED,
    ) -> None:
        """Seed the filter, once: the rover stands at ``pose`` (course frame) at time ``t``.

        ``odometry`` is the pose in odometry's own frame, by default the same. ``covariance`` (3, 3) is that
        of ``pose``, which is exact without it, and ``lasting`` the lasting error of its source.
        """
        if self._started is not None:
            raise RuntimeError("the estimator is seeded once and never again")
        own = self._own = pose if odometry is None else odometry
        if not all(map(math.isfinite, (*pose, *own, t))):
            raise ValueError(f"cannot start from {pose}, odometry {own}, at {t}")
        known = None if covariance is None else completed(covariance, self._settings)
        if covariance is not None and known is None:
            raise ValueError(f"cannot start with the covariance {covariance}")
        self._settings = s = self._settings.model_copy(update=lasting_settings(lasting, known))
        self._started = History(s, t, own, pose, known)

    def take(self, sample: OdometrySample | TurnSample | PoseSample, t: float) -> None:
        """Apply a sample that was measured at ``t``."""
        match sample:
            case OdometrySample(_, pose, velocity):
                self.odometry(pose, velocity, t)
            case PoseSample(_, _, pose, covariance):
                self.external(pose, covariance, t)
            case TurnSample(_, rate):
                self.gyro(rate, t)

    def odometry(self, pose: Pose, velocity: Velocity, t: float) -> Acceptance:
        """Apply odometry measured at ``t``: pose in its own frame, v in m/s, ω in rad/s."""
        z = np.array([*pose, *velocity])
        if not (np.isfinite(z).all() and math.isfinite(t)):
            outcome = Acceptance.NOT_FINITE
        else:
            due = self._bursts.due(t)
            if due < t and self._history.misfit(z, due) < self._history.misfit(z, t):
                t = due
            outcome, turn, waited = self._history.odometry(z, self._gyro.angle(t), t)
            self._count_gyro(turn)
        if outcome is Acceptance.ACCEPTED:
            self._in_a_row[ODOMETRY] = 0
            self._own = pose
            for waiting in waited:
                self._count(waiting)
            if self._corrected:
                self._corrected = False
                self._check_turn_gain()
        else:
            self.rejected += 1
            self._reject(ODOMETRY, outcome, self._settings.rejected_in_a_row, "estimator")
        return outcome

    def gyro(self, rate: float, t: float) -> None:
        """Apply a gyro's rate of turn in rad/s, the mean since its last.

        It may come before or after the odometry of ``t``.
        """
        if not (math.isfinite(rate) and math.isfinite(t)):
            outcome = Acceptance.NOT_FINITE
        elif abs(rate - self._history.turn_rate()) > self._gyro_off_rad_s:
            outcome = Acceptance.OUTLIER
        else:
            self._gyro.measure(rate, t)
            return
        self._gyro.miss()
        self._count_gyro(outcome)

    def external(self, pose: Pose, covariance: Array, t: float) -> Acceptance:
        """Apply an external pose (course frame) that was measured at ``t`` or earlier, and may come late.

        ``covariance`` (3, 3) is that of (x, y, θ); a variance of 0 means unknown.
        """
        known = completed(covariance, self._settings)
        if known is None or not all(map(math.isfinite, (*pose, t))):
            outcome = Acceptance.NOT_FINITE
        elif self._repeated(pose):
            outcome = Acceptance.REPEATED
        else:
            outcome = self._history.pose(np.array(pose), known, t)
        self._count(outcome)
        return outcome

    def _repeated(self, pose: Pose) -> bool:
        """Return whether a localiser sends the same pose again although the rover moved."""
        if self._changed is None or pose != self._changed[0]:
            self._changed = pose, self._own
        return not near(self._own, self._changed[1], REPEATED_M, REPEATED_RAD)

    def at(self, t: float) -> Estimate:
        """Return the estimate at ``t``: predicted, or of the last second; before that, its oldest."""
        x, P = self._history.at(t)
        ahead, _, turn = true_motion(x, self._settings)
        rows = np.zeros((5, SIZE))
        rows[:3, POSE] = np.eye(3)
        turned, by_omega = turned_without_gain(float(x[OMEGA]), self._settings)
        rows[4, OMEGA], rows[4, GAIN] = x[GAIN] * by_omega, turned
        rows[4, V], rows[4, WHEEL_MISMATCH], rows[4, GYRO] = x[WHEEL_MISMATCH], x[V], turn / x[GYRO] ** 2
        rows[4] *= x[GYRO]
        rows[3] = x[ASIDE] * rows[4]
        rows[3, V] += x[DISTANCE]
        rows[3, DISTANCE], rows[3, ASIDE] = x[V], turn
        pose = Pose(*x[POSE].tolist())
        return Estimate(
            t, pose, Velocity(ahead, turn), rows @ P @ rows.T, float(x[GYRO] * x[GAIN]), float(x[CENTER])
        )

    @property
    def turn_gain(self) -> float:
        """True turn over odometry's, by the newest estimate."""
        return self.at(self._history.t).turn_gain

    @property
    def odometry_pose(self) -> Pose:
        """The newest pose of odometry, in its own frame."""
        return self._own

    @property
    def heading_error_rad(self) -> float:
        """Heading of the estimate, as external poses show it, minus the direction of travel."""
        return float(self._history.at(self._history.t)[0][MOUNT])

    @property
    def lasting_covariance(self) -> Array:
        """Covariance (3, 3) of the lasting error that the source of poses had when it showed a place.

        Where the poses of a drive show a larger error than the source declares, it had that error then, too.
        """
        return np.diag(lasting_variances(self._history.settings))

    @property
    def nis(self) -> dict[str, float | None]:
        """Mean NIS of the accepted external poses while the rover stood and moved; 3 is expected."""
        sums = self._started.nis if self._started else {}
        means = {stood: total / count for stood, (count, total) in sums.items() if count}
        return {"standing": means.get(True), "moving": means.get(False)}

    @property
    def _history(self) -> History:
        if self._started is None:
            raise RuntimeError("the estimator was not started")
        return self._started

    def _count_gyro(self, outcome: Acceptance | None) -> None:
        if outcome is Acceptance.ACCEPTED:
            self._in_a_row[GYRO_READINGS] = 0
        elif outcome is not None:
            self.gyro_rejected += 1
            if self._history.t - self._gyro_counted >= TURN_S:  # at any rate of readings, n are as long
                self._gyro_counted = self._history.t
                self._reject(GYRO_READINGS, outcome, self._settings.gyro_rejected_in_a_row, "gyro")

    def _count(self, outcome: Acceptance) -> None:
        self.poses[outcome] += 1
        if outcome is Acceptance.ACCEPTED:
            self._in_a_row[POSES] = 0
            self._corrected = True
        elif outcome in {Acceptance.OUTLIER, Acceptance.NOT_FINITE, Acceptance.REPEATED}:
            self._reject(POSES, outcome, self._settings.poses_rejected_in_a_row, "external-pose")
        if outcome in {Acceptance.ACCEPTED, Acceptance.OUTLIER}:
            self._judged.append(outcome is Acceptance.OUTLIER)
            if (rejected := sum(self._judged)) >= REJECTED_POSES:
                self._fail(f"{rejected} of the last {len(self._judged)} {POSES} rejected", "external-pose")

    def _check_turn_gain(self) -> None:
        x, P = self._history.at(self._history.t)
        gain, std = (float(each) / self._settings.turn_gain for each in (x[GAIN], math.sqrt(P[GAIN, GAIN])))
        if not GAINS[0] - 2.0 * std <= gain <= GAINS[1] + 2.0 * std:
            words = f"by the external poses the rover turns {gain:.1f} times what odometry says"
            self._fail(f"{words}: is their frame turned or mirrored, or are they late?", "external-pose")

    def _reject(self, what: str, outcome: Acceptance, limit: int, rule: str) -> None:
        """Count a rejection; so many in a row are the fault ``rule``."""
        self._in_a_row[what] += 1
        if self._in_a_row[what] >= limit:
            why = ": the gyro is wrong, or the wheels spin" if what == GYRO_READINGS else ""
            self._fail(f"{self._in_a_row[what]} {what} rejected in a row (last: {outcome.value}){why}", rule)

    def _fail(self, words: str, rule: str) -> None:
        """Note the first fault."""
        if not self.fault:
            self.fault, self.fault_rule = words, rule


def lasting_settings(lasting: LastingError, covariance: Array | None) -> dict[str, float]:
    """Return the settings for a source of poses, whose newest pose has a ``covariance`` (3, 3).

    A source that declares no time may mean its lasting error by its covariance.
    """
    position_m, heading_rad, time_s = lasting.values
    if covariance is not None and not lasting.declared:
        x_m, y_m, told_rad = np.sqrt(np.diag(covariance)).tolist()
        position_m, heading_rad = max(position_m, x_m, y_m), max(heading_rad, told_rad)
    return {"lasting_m": position_m, "lasting_rad": heading_rad, "lasting_s": time_s}


def completed(covariance: Array, settings: EstimatorSettings) -> Array | None:
    """Return an external pose's covariance with unknown variances filled in; None if it is invalid."""
    matrix = np.array(covariance, dtype=np.float64)
    if not np.isfinite(matrix).all() or (np.diag(matrix) < 0).any() or np.abs(matrix).max() > MAX_VARIANCE:
        return None
    default = np.square([settings.pose_m, settings.pose_m, settings.pose_rad])
    matrix[np.diag_indices(3)] = np.where(np.diag(matrix) == 0.0, default, np.diag(matrix))
    matrix = 0.5 * (matrix + matrix.T)
    return matrix if np.linalg.eigvalsh(matrix).min() > 0.0 else None
