"""Noises and limits of the estimator's two filters, and the outcomes of a measurement."""

from enum import Enum

from pydantic import Field

from rover_ncp.core.config import StrictModel


class EstimatorSettings(StrictModel):
    """SI units. The errors of odometry are those of an unmeasured base (standard deviations)."""

    position_m: float = Field(default=0.0005, gt=0, description="odometry, position: steps of 1 mm")
    heading_rad: float = Field(default=0.0007, gt=0, description="odometry, heading: steps of 0.09°")
    speed_m_s: float = Field(default=0.003, gt=0, description="odometry, speed: whole mm/s per wheel")
    turn_rad_s: float = Field(default=0.006, gt=0, description="odometry, turn rate: from whole mm/s")
    acceleration: float = Field(default=0.01, gt=0, description="process noise of v in (m/s)²/s")
    angular_acceleration: float = Field(default=0.16, gt=0, description="process noise of ω in (rad/s)²/s")
    slip: float = Field(default=1e-6, gt=0, description="process noise of x and y in m²/s")
    gate: float = Field(default=25.74, gt=0, description="largest NIS: 1 in 10,000 of a χ² with 5 degrees")
    rejected_in_a_row: int = Field(default=3, ge=1, description="so many rejected in a row are a fault")

    distance_scale: float = Field(default=0.0173, gt=0, description="share: ±3 % evenly spread")
    turn_scale: float = Field(default=0.03, gt=0, description="share: ±3 %, and what wheels skid")
    imbalance_rad_m: float = Field(default=0.0173, gt=0, description="unseen turn per way: ±0.03 rad/m")
    drift_rad_s: float = Field(default=0.0005, gt=0, description="of the heading: ±0.05 °/s")
    wander_m: float = Field(default=0.001, gt=0, description="random, after a metre")
    wander_rad: float = Field(default=0.002, gt=0, description="random, after a metre")
    skid_rad: float = Field(default=0.003, gt=0, description="random, after a turn of 1 rad")
    gyro_bias_rad_s: float = Field(default=0.2, gt=0, description="bias of a gyro")
    gyro_rad: float = Field(default=0.0007, gt=0, description="noise of a gyro's turn in 0.1 s")

    pose_m: float = Field(default=0.02, gt=0, description="external pose without a covariance")
    pose_rad: float = Field(default=0.035, gt=0)
    pose_gate: float = Field(default=21.11, gt=0, description="largest NIS: 1 in 10,000 with 3 degrees")
    poses_rejected_in_a_row: int = Field(default=5, ge=1, description="so many are a fault")
    history_s: float = Field(default=1.0, gt=0, description="how late an external pose may come")


class Outcome(Enum):
    """Outcome of a measurement."""

    ACCEPTED = "accepted"
    OUTLIER = "outlier"
    NOT_FINITE = "not finite"
    OUT_OF_ORDER = "out of order"
    WAITING = "newer than odometry, which it waits for"
    TOO_OLD = "too old"
