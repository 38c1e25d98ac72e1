"""The filter with its recent measurements, so that a late external pose is applied at its own moment.

Rules of this file:

1. An external pose is applied at the moment of its measurement. A late pose is inserted into a short
   history, and later measurements are applied again. A pose that is newer than odometry waits.
2. A measurement is accepted or rejected once, when it is first evaluated, by its normalised innovation
   squared (NIS).
3. A pose may fail its gate while the rover moves. If the covariance of a disturbance explains it, such as a
   cable under the wheels, that covariance is added once until a pose is accepted. The pose is rejected all
   the same: it does not move the estimate, and the next pose can correct it. While the rover stands, this
   takes three poses that show one place, as after a push. The poses of a camera that lags do not.
4. The rover stands between two odometry samples that report no motion and the same place, both within their
   declared noise. Its pose then stays the same, and noise does not move the estimate.
5. Odometry whose speeds are means, or contradict its pose, or whose steps alternate, is irregular: its pose
   alone is applied, with the noise of stamps that are some milliseconds off and of a coarse heading. If
   that does not fit, it is rejected. After speeds that contradicted their pose, no speed is applied for some
   seconds.
"""

import math
from bisect import bisect_right, insort
from dataclasses import dataclass

import numpy as np

from deploy.estimator.filter import Filter, Measured
from deploy.estimator.gyro_turns import GyroTurns
from deploy.estimator.inputs import (
    Acceptance,
    Applied,
    Disturbance,
    GyroAngle,
    LongerErrors,
    Odometry,
    PoseMeasurement,
    Whiteness,
    normalised_square,
    residual,
    squared,
    stands,
    still_limits,
    whitened,
)
from deploy.estimator.motion import (
    BIAS,
    DELAY,
    GYRO,
    MOTION,
    OWN,
    THETA,
    Array,
    initial,
    lasting_variances,
    moving,
    standing,
    true_motion,
    turned_without_gain,
)
from deploy.estimator.settings import EstimatorSettings
from rover_ncp.core.geometry import Pose, wrap_angle
from rover_ncp.robot.lasting_error import BY_KIND, Kind

PUSH_POSES = 3
"""Poses that show a push of a rover that stands. Two of a camera that lags can agree by chance."""
GAP_S = 10.0
"""After a longer gap any motion would fit, so only odometry of a rover that stands is accepted."""
WAITING_MAX = 100
"""Maximum number of poses that wait for odometry."""
IRREGULAR_S = 10.0
"""Time for which speeds do not count after one that contradicted its pose."""
TURN_S = 0.08
"""Minimum time over which a gyro's turn is compared with odometry's."""
REPORTED = slice(OWN.start, MOTION.stop)


@dataclass(frozen=True, eq=False)
class _Entry:
    """A measurement at ``t`` s, and the state after it."""

    t: float
    stood: bool
    """Whether the rover stood since the entry before."""
    measured: Measured
    x: Array
    P: Array


class History:
    """Begins at rest at ``pose`` (course frame), where odometry is at ``own``.

    ``covariance`` (3, 3) is that of a pose by external poses.
    """

    def __init__(
        self, settings: EstimatorSettings, t: float, own: Pose, pose: Pose, covariance: Array | None
    ) -> None:
        s, self._filter = settings, Filter(settings)
        x, P = initial(s, own, pose, covariance)
        self._still = still_limits(settings)
        z = np.array([*own, 0.0, 0.0])
        self._entries = [_Entry(t, True, Odometry(z), x, P)]
        self._valid = 1
        """Number of entries that include all earlier ones. Later entries are applied again when needed."""
        self._waiting: list[tuple[float, PoseMeasurement]] = []
        self._last = t, z
        """Time and numbers of the newest odometry."""
        push = np.square([s.disturbance_m, s.disturbance_m, s.disturbance_rad])
        self._disturbance = Disturbance(np.diag(push))
        self._irregular_until = -math.inf
        """Until when the speeds of odometry do not count, s."""
        self._disturbed = False
        """Whether the covariance grew by a disturbance since the last accepted pose."""
        self._rejected: list[PoseMeasurement] = []
        """The first poses that were rejected since the last accepted one."""
        self._turn_began = t, GyroAngle(math.nan, t), 0.0
        """Begin of the turn in s, the gyro's angle there, and odometry's turn since that angle's reading."""
        self._white, self._gyro_turns = Whiteness(), GyroTurns(self._filter)
        self.nis: dict[bool, tuple[int, float]] = {True: (0, 0.0), False: (0, 0.0)}
        """Number and sum of the NIS of external poses, while the rover stood and while it moved."""

    @property
    def settings(self) -> EstimatorSettings:
        """The settings of now, whose lasting error may be larger than the declared one."""
        return self._filter.settings

    @property
    def t(self) -> float:
        """The moment of the newest odometry."""
        return self._last[0]

    def odometry(self, z: Array, angle: GyroAngle, t: float) -> Applied:
        """Apply odometry, and the angle of a gyro (NaN: not known, a new zero)."""
        began, before, ahead_before = self._turn_began
        if math.isnan(angle.rad):  # also if this sample is rejected: turns are not compared across a gap
            self._turn_began = began, angle, 0.0
        if t < self.t:
            return Applied(Acceptance.OUT_OF_ORDER)
        stood = self._stands(z)
        fits = self._predicted(z, t, stood)[0] <= self.settings.gate
        if t > self.t + GAP_S and not (stood and fits):
            return Applied(Acceptance.OUTLIER)
        if stood and not fits:  # declared noise may hide a slow motion
            stood, fits = False, self._predicted(z, t, False)[0] <= self.settings.gate
        irregular = not (fits and self.settings.uses_speeds and t > self._irregular_until)
        if irregular and not self._filter.pose_fits(z):
            return Applied(Acceptance.OUTLIER)
        if not fits:
            self._irregular_until = t + IRREGULAR_S
        turn, turn_outcome = None, None
        self._filter.correct_by_odometry(z, stood, irregular)
        turned, seconds = angle.rad - before.rad, angle.t - before.t
        # Without a reading the gyro says nothing: a turn would only confirm what is assumed.
        ends_turn = math.isnan(turned) or (t - began >= TURN_S and seconds > 0.0)
        if ends_turn:
            ahead = self._turned_since(angle.t, z[THETA], t)
            self._turn_began = t, angle, ahead
            if math.isfinite(turned):
                turn = self._gyro_turns.apply(turned, seconds, ahead - ahead_before)
                turn_outcome = Acceptance.ACCEPTED if turn else Acceptance.OUTLIER
        self._entries.append(self._entry(t, stood, Odometry(z, ends_turn, turn, irregular)))
        self._last = t, z
        self._valid += 1
        due = bisect_right(self._waiting, t, key=lambda waiting: waiting[0])
        outcomes = tuple(self._insert(*waiting) for waiting in self._waiting[:due])
        del self._waiting[:due]
        # The last entry before the window stays: it is where a pose at the window's edge starts from.
        oldest = t - self.settings.history_s
        keep = max(bisect_right(self._entries, oldest, key=lambda entry: entry.t) - 1, 0)
        self._apply_again(keep + 1)
        del self._entries[:keep]
        self._valid -= keep
        return Applied(Acceptance.ACCEPTED, turn_outcome, outcomes)

    def misfit(self, z: Array, t: float) -> float:
        """Return −2 log likelihood, but for a constant, of odometry measured at ``t``."""
        if not self.t <= t <= self.t + GAP_S:
            return math.inf
        nis, covariance = self._predicted(z, t, self._stands(z))
        return nis + float(np.linalg.slogdet(covariance)[1])

    def _predicted(self, z: Array, t: float, stood: bool) -> tuple[float, Array]:
        """Predict the filter to ``t``; return the NIS of odometry there, and its covariance (5, 5)."""
        self._apply_again(len(self._entries))
        self._predict(self._entries[-1], t, stood)
        covariance = self._filter.P[REPORTED, REPORTED] + self._filter.odometry_covariance
        return normalised_square(residual(z, self._filter.x[REPORTED]), covariance), covariance

    def pose(self, z: Array, covariance: Array, t: float) -> Acceptance:
        """Apply an external pose of stamp ``t`` at its moment, unless it is rejected."""
        begin = self._entries[0].t
        if t < begin:
            return Acceptance.TOO_OLD
        at = max(t - max(float(self._entries[self._valid - 1].x[DELAY]), 0.0), begin)
        measured = PoseMeasurement(z, covariance, t - at)
        if at <= self.t:
            return self._insert(at, measured)
        if len(self._waiting) >= WAITING_MAX:
            return Acceptance.DROPPED
        insort(self._waiting, (at, measured), key=lambda waiting: waiting[0])
        return Acceptance.WAITING

    def turn_rate(self) -> float:
        """Return the turn rate that a gyro should show."""
        x = self._entries[self._valid - 1].x
        return true_motion(x, self.settings)[2] / float(x[GYRO]) + float(x[BIAS])

    def _turned_since(self, begin: float, heading: float, t: float) -> float:
        """Return odometry's turn before the turn gain (rad) from ``begin`` until its ``heading`` of ``t``."""
        turned, after, seconds = 0.0, t, t - begin
        for entry in reversed(self._entries):
            if after <= begin:
                break
            if isinstance(entry.measured, Odometry) and entry.t < after:
                before = float(entry.measured.z[THETA])
                turned += wrap_angle(heading - before) * min(1.0, (after - begin) / (after - entry.t))
                after, heading = entry.t, before
        return turned_without_gain(turned / seconds, self.settings)[0] * seconds if seconds > 0.0 else 0.0

    def at(self, t: float) -> tuple[Array, Array]:
        """Return state (23,) and covariance (23, 23) at ``t``, before the history those of its begin."""
        self._apply_again(len(self._entries))
        place = max(bisect_right(self._entries, t, key=lambda entry: entry.t), 1)
        before, dt = self._entries[place - 1], max(t - self._entries[place - 1].t, 0.0)
        stood = place < len(self._entries) and self._entries[place].stood
        step = standing if stood else moving
        x, jacobian, Q = step(before.x, dt, self.settings, new_turn=True)
        return x, jacobian @ before.P @ jacobian.T + Q

    def _stands(self, z: Array) -> bool:
        """Return whether a sample and the one before report no motion, and the same place."""
        return stands(self._last[1], z, self._still)

    def _insert(self, t: float, measured: PoseMeasurement) -> Acceptance:
        place = bisect_right(self._entries, t, key=lambda entry: entry.t)
        self._apply_again(place)
        stood = self._entries[min(place, len(self._entries) - 1)].stood
        self._predict(self._entries[place - 1], t, stood)
        innovation, covariance = self._filter.expected(measured)
        white = whitened(innovation, covariance)
        if not self._white.passes(white, math.sqrt(self.settings.pose_gate)):
            self._entries.insert(place, self._updated(t, stood, self._longer_errors()))
            place, self._valid = place + 1, place + 1
            self._predict(self._entries[place - 1], t, stood)
            innovation, covariance = self._filter.expected(measured)
            white = whitened(innovation, covariance)
        nis = squared(white)
        accepted = nis <= self.settings.pose_gate
        if accepted:
            count, total = self.nis[stood]
            self.nis[stood] = count + 1, total + nis
        disturbed = (
            not (accepted or self._disturbed)
            and (not stood or self._pushed(measured))
            and self._filter.passes(innovation, covariance + self._disturbance.covariance)
        )
        if accepted or disturbed:
            self._entries.insert(place, self._updated(t, stood, measured if accepted else self._disturbance))
            self._valid = place + 1
        self._disturbed = disturbed or (self._disturbed and not accepted)
        self._rejected = [] if accepted else [*self._rejected, measured][: PUSH_POSES - 1]
        return Acceptance.ACCEPTED if accepted else Acceptance.OUTLIER

    def _longer_errors(self) -> LongerErrors:
        """Double the lasting error of the external poses, up to an unknown source's; return what is added."""
        s, (max_m, max_rad, _) = self.settings, BY_KIND[Kind.UNKNOWN]
        larger = {
            "lasting_m": max(s.lasting_m, min(2.0 * s.lasting_m, max_m)),
            "lasting_rad": max(s.lasting_rad, min(2.0 * s.lasting_rad, max_rad)),
        }
        self._filter.settings = s.model_copy(update=larger)
        return LongerErrors(np.diag(lasting_variances(self.settings) - lasting_variances(s)))

    def _pushed(self, measured: PoseMeasurement) -> bool:
        """Return whether this pose and enough rejected ones show the same place."""
        return len(self._rejected) == PUSH_POSES - 1 and all(
            self._filter.passes(residual(measured.z, before.z), measured.covariance + before.covariance)
            for before in self._rejected
        )

    def _apply_again(self, count: int) -> None:
        """Bring the first ``count`` entries up to date."""
        for place in range(self._valid, count):
            entry = self._entries[place]
            self._predict(self._entries[place - 1], entry.t, entry.stood)
            self._entries[place] = self._updated(entry.t, entry.stood, entry.measured)
        self._valid = max(self._valid, count)

    def _predict(self, before: _Entry, t: float, stood: bool) -> None:
        """Bring the filter from an entry to time ``t``."""
        new_turn = isinstance(before.measured, Odometry) and before.measured.ends_turn
        self._filter.bring(before.x, before.P, t - before.t, stood=stood, new_turn=new_turn)

    def _updated(self, t: float, stood: bool, measured: Measured) -> _Entry:
        """Apply a measurement to the filter, which is at its time; return its entry."""
        self._filter.apply(measured, stood)
        return self._entry(t, stood, measured)

    def _entry(self, t: float, stood: bool, measured: Measured) -> _Entry:
        return _Entry(t, stood, measured, *self._filter.copies())
