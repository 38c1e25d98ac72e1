"""What the filter is given, and what becomes of it."""

from enum import Enum
from typing import NamedTuple

from deploy.estimator.motion import Array


class Outcome(Enum):
    """Outcome of a measurement."""

    ACCEPTED = "accepted"
    OUTLIER = "outlier"
    NOT_FINITE = "not finite"
    OUT_OF_ORDER = "out of order"
    WAITING = "newer than odometry, which it waits for"
    TOO_OLD = "too old"
    DROPPED = "too many poses wait for odometry"


class Turn(NamedTuple):
    """Angle (rad) that a gyro turned in some seconds, its variance, and that of a disturbance."""

    angle: float
    seconds: float
    variance: float
    disturbance_variance: float = 0.0


class Odometry(NamedTuple):
    """A sample: pose and motion (5,), whether a turn ends with it, and that turn if a gyro showed it."""

    z: Array
    ends_turn: bool = True
    turn: Turn | None = None
    irregular: bool = False


class Applied(NamedTuple):
    """Outcome of an odometry sample, of its gyro's turn (None without), and of the poses that waited."""

    odometry: Outcome
    turn: Outcome | None = None
    poses: tuple[Outcome, ...] = ()


class PoseMeasurement(NamedTuple):
    """An external pose (x, y, θ) with its covariance (3, 3), and its stamp minus the entry's time in s."""

    z: Array
    covariance: Array
    assumed_delay_s: float


class Disturbance(NamedTuple):
    """A motion that no sensor of the base reports, by its covariance (3, 3) in x, y, θ."""

    covariance: Array
