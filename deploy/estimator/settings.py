"""Noises, priors and limits of the estimator."""

from pydantic import Field

from rover_ncp.core.config import StrictModel

GYRO_S = 0.1
"""`EstimatorSettings.gyro_rad` is the noise of so long a turn, s."""
TURN_GAINS = 0.5, 2.0
"""Limits of the true turn over odometry's: no description has robots beyond them."""


class EstimatorSettings(StrictModel):
    """SI units. Deviations (``_std``) are those of an unmeasured skid-steered base."""

    position_m: float = Field(default=0.0005, gt=0, description="odometry, position: steps of 1 mm")
    heading_rad: float = Field(default=0.0007, gt=0, description="odometry, heading: steps of 0.09°")
    speed_m_s: float = Field(default=0.003, gt=0, description="odometry, speed: whole mm/s per wheel")
    turn_rad_s: float = Field(default=0.006, gt=0, description="odometry, turn rate: from whole mm/s")
    uses_speeds: bool = Field(default=True, description="whether odometry's speeds are of the moment")
    acceleration: float = Field(default=0.01, gt=0, description="process noise of v in (m/s)²/s")
    angular_acceleration: float = Field(default=0.16, gt=0, description="process noise of ω in (rad/s)²/s")
    slip: float = Field(default=1e-6, gt=0, description="process noise of x and y in m²/s")
    gate: float = Field(default=25.74, gt=0, description="largest NIS: 1 in 10,000 of a χ² with 5 degrees")
    rejected_in_a_row: int = Field(default=3, ge=1, description="rejections in a row that are a fault")

    distance_gain: float = Field(default=1.0, gt=0, description="true distance over odometry's")
    distance_gain_std: float = Field(default=0.025, gt=0, description="±4 %: tyres, and slip on slopes")
    turn_gain: float = Field(default=1.0, gt=0, description="true turn over odometry's")
    turn_gain_std: float = Field(default=0.25, gt=0, description="weight off the middle: up to 1.5")
    slip_s: float = Field(default=0.0, ge=0, description="slipped share of a turn, per rad/s of odometry")
    turn_asymmetry: float = Field(
        default=0.0, gt=-1, lt=1, description="turn to the left beside the encoders', per angle"
    )
    wheel_mismatch_rad_m: float = Field(default=0.0, description="turn per distance beside the encoders'")
    wheel_mismatch_std_rad_m: float = Field(default=0.025, gt=0, description="±0.03 rad/m, and slopes")
    rotation_center_m: float = Field(default=0.0, description="lateral velocity over turn rate")
    rotation_center_std_m: float = Field(default=0.08, gt=0, description="up to half a wheelbase")
    rotation_center_left_m: float = Field(
        default=0.0, description="speed beside the encoders' over turn rate"
    )
    rotation_center_left_std_m: float = Field(default=0.03, gt=0)
    half_track_m: float = Field(default=0.294, gt=0, description="effective, for slip of one side's wheels")
    half_wheelbase_m: float = Field(default=0.135, ge=0, description="for slip of one axle's wheels")
    downhill_x_m: float = Field(default=0.0, description="slide per turn, along the heading at the start")
    downhill_y_m: float = Field(default=0.0, description="slide per turn, to the left of it")
    downhill_std_m: float = Field(
        default=0.015, gt=0, description="slide per turn: a slope of 1 to 3 degrees"
    )
    gyro_bias_std_rad_s: float = Field(default=0.2, gt=0)
    gyro_bias_walk_rad_s: float = Field(default=0.0005, gt=0, description="random change after 1 s")
    gyro_scale_std: float = Field(default=0.02, gt=0, description="true turn over the gyro's")
    gyro_rad: float = Field(default=0.0007, gt=0, description="noise of a gyro's turn in 0.1 s")
    gyro_gate: float = Field(default=6.63, gt=0, description="largest NIS: 1 in 100 with 1 degree")
    gyro_disturbance_rad_s: float = Field(default=0.15, gt=0, description="turn rate of a disturbance")
    gyro_rejected_in_a_row: int = Field(default=10, ge=1, description="number that is a fault")

    wander_m: float = Field(default=0.005, gt=0, description="random, after a metre")
    wander_rad: float = Field(default=0.002, gt=0, description="random, after a metre")
    skid_m: float = Field(default=0.001, gt=0, description="random, after a turn of 1 rad")
    skid_rad: float = Field(default=0.003, gt=0, description="random, after a turn of 1 rad")
    creep_m: float = Field(default=0.0004, gt=0, description="random, after standing for 1 s")
    creep_rad: float = Field(default=0.0003, gt=0, description="random, after standing for 1 s")
    turn_gain_walk: float = Field(default=0.1, gt=0, description="random change after a turn of 1 rad")

    pose_m: float = Field(default=0.02, gt=0, description="external pose without a covariance")
    pose_rad: float = Field(default=0.035, gt=0)
    lasting_m: float = Field(default=0.08, ge=0, description="lasting error of poses")
    lasting_rad: float = Field(default=0.05, ge=0, description="lasting error of their heading")
    lasting_s: float = Field(default=20.0, gt=0, description="its time constant")
    mount_std_rad: float = Field(
        default=0.0, ge=0, description="constant error of their heading, as by the yaw of a camera's mount"
    )
    pose_delay_s: float = Field(default=0.05, ge=0, description="expected delay of all poses")
    pose_delay_std_s: float = Field(default=0.05, gt=0)
    pose_gate: float = Field(default=21.11, gt=0, description="largest NIS: 1 in 10,000 with 3 degrees")
    poses_rejected_in_a_row: int = Field(default=5, ge=1, description="number that is a fault")
    disturbance_m: float = Field(default=0.02, gt=0, description="x and y of a disturbance, such as a cable")
    disturbance_rad: float = Field(default=0.03, gt=0, description="heading of a disturbance")
    history_s: float = Field(default=1.0, gt=0, description="maximum delay of an external pose")
