"""The turns that a gyro measures, against those of odometry.

Rules of this file:

1. A turn that fits corrects the turn gain and the bias of the gyro.
2. A turn that does not fit is a disturbance, if one explains it, such as a cable under a wheel. The heading
   follows it, with a standard deviation that also covers a false reading. A long disturbance is rejected.
3. Two turns in a row that do not fit show another floor if both ask for a larger turn gain, or both for a
   smaller one. The turn gain is then free to change.
4. Where the turn gain has changed, other wheels slip than before, and the centre of rotation has moved.
   A gyro does not show where to, so its variance grows.
5. A turn that would need a turn gain beyond `GYRO_GAINS` is no slip. It is a disturbance or rejected.
"""

import math

import numpy as np

from deploy.estimator.filter import CENTERS, Filter
from deploy.estimator.inputs import Turn
from deploy.estimator.motion import GAIN, TURN
from deploy.estimator.settings import GYRO_S

MIN_TURN_RAD = 0.004
"""Smallest turn by odometry that can show another turn gain."""
MIN_GAIN_CHANGE = 0.15
"""Smallest share by which the turn gain changes where the centre of rotation moves."""
LEARNT_STD = 0.1
"""Standard deviation of a turn gain that is learnt, as a share of it."""
AXLE_SLIP = 0.33
"""Share of a turn by which one axle's wheels slip at most: the robot then turns about the other axle."""
GYRO_GAINS = 0.1, 4.0
"""Limits of the true turn over odometry's: what a gyro shows beyond them is no slip. A rover that turns less
does not follow its commands."""
MAX_DISTURBANCE_RAD = 0.2
"""Largest disturbance that the estimate follows."""
DISTURBANCE_END_NIS = 1.0
"""Largest NIS that ends a disturbance."""
DISTURBANCE_STD_SHARE = 0.3
"""Standard deviation of a disturbance that a gyro shows, as a share of it."""


class GyroTurns:
    """Applies the turns of a gyro to a filter that is at their end."""

    def __init__(self, ekf: Filter) -> None:
        self._filter = ekf
        self._disturbance_rad = 0.0
        """Size of the disturbance that the last turns show, rad."""
        self._sign = 0.0
        """1 if the last turn did not fit and needs a larger turn gain, −1 if a smaller one, else 0.

        Of a rover that hardly turns it is 0, because its turn gain is not known."""
        self._known_gain: float | None = None
        """The turn gain to which the variance of the centre of rotation belongs; None before it is learnt."""

    def apply(self, angle: float, seconds: float, ahead: float) -> Turn | None:
        """Apply a gyro's turn, as a disturbance if it does not fit; return it, None if it is rejected."""
        s, x, P = self._filter.settings, self._filter.x, self._filter.P
        turned = float(x[TURN] / x[GAIN]) if x[GAIN] > 0.0 else 0.0
        turn = Turn(angle, seconds, ahead, turned, s.gyro_rad**2 * seconds / GYRO_S)
        row = turn.row[0]
        variance = float(row @ P @ row) + turn.variance
        missing = angle - float(row @ x)
        gain = float(x[GAIN] + P[GAIN] @ row / variance * missing)
        minimum, maximum = (limit * s.turn_gain for limit in GYRO_GAINS)
        gate = DISTURBANCE_END_NIS if self._disturbance_rad else s.gyro_gate
        # What the gyro measured of odometry's turn.
        seen = turned - ahead
        needed = float(x[GAIN]) + missing / seen if abs(seen) >= MIN_TURN_RAD else math.nan
        before = self._sign
        self._sign = 0.0 if math.isnan(needed) else math.copysign(1.0, needed - x[GAIN])
        if missing**2 <= gate * variance and (
            minimum <= gain <= maximum or abs(gain - s.turn_gain) < abs(x[GAIN] - s.turn_gain)
        ):
            self._disturbance_rad = self._sign = 0.0
        elif minimum <= needed <= maximum and before == self._sign:
            turn = turn._replace(gain_variance=(needed - x[GAIN]) ** 2)
            self._disturbance_rad = 0.0
        else:
            self._disturbance_rad += abs(missing)
            turn = turn._replace(
                variance=turn.variance + (DISTURBANCE_STD_SHARE * missing) ** 2,
                disturbance_variance=(s.gyro_disturbance_rad_s * seconds) ** 2,
            )
            if self._disturbance_rad > MAX_DISTURBANCE_RAD or missing**2 > s.gyro_gate * (
                variance + turn.disturbance_variance
            ):
                return None
        self._filter.correct_by_turn(turn)
        turn = turn._replace(center_variances=self._center_variances())
        self._filter.P[CENTERS, CENTERS] += turn.center_variances
        return turn

    def _center_variances(self) -> tuple[float, float]:
        """Return how much less is known of the centre of rotation, m², because the turn gain has changed.

        The gain falls where the wheels of one side slip, which moves the centre to the other side. It rises
        where those of one axle slip, which moves it towards the other axle. A gyro does not show which.
        """
        s = self._filter.settings
        minimum, maximum = (limit * s.turn_gain for limit in GYRO_GAINS)
        gain = min(max(float(self._filter.x[GAIN]), minimum), maximum)
        std = math.sqrt(self._filter.P[GAIN, GAIN]) / gain
        known = self._known_gain
        learnt = known is None and std < LEARNT_STD
        if not learnt and (known is None or abs(math.log(gain / known)) < max(MIN_GAIN_CHANGE, 2.0 * std)):
            return 0.0, 0.0
        self._known_gain = gain
        slips = [s.turn_gain / each - 1.0 for each in (known or s.turn_gain, gain)]
        behind_m = [s.half_wheelbase_m * min(math.sqrt(abs(slip) / AXLE_SLIP), 1.0) for slip in slips]
        left_m = [2.0 * s.half_track_m * max(slip, 0.0) for slip in slips]
        # The prior of the centre behind the middle holds for all turn gains.
        moved_m = 0.0 if known is None else behind_m[1] - behind_m[0]
        grown = np.square([moved_m, left_m[1] - left_m[0]])
        bounds = np.square([s.half_wheelbase_m, max(left_m)])
        behind, left = np.clip(bounds - self._filter.P[CENTERS, CENTERS], 0.0, grown).tolist()
        return behind, left
