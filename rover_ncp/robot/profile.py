"""Robot profile: measured properties of one robot, which training, evaluation, mock and driver accept.

Simulations draw the values that a profile leaves out from their randomization; the driver works without them.
Gains are the speed that odometry reports over the commanded speed: the robot alone can measure no others.
Errors of odometry and unseen slip can only be measured with external poses.
"""

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field

from rover_ncp.core.config import StrictModel, load_yaml

_Delay = Field(default=None, ge=0, le=2)
_Factor = Field(default=None, gt=0.2, lt=5)


class RoverProfile(StrictModel):
    """SI units; factors are 1 for a robot as it should be, None where nothing is known."""

    format: Literal[1] = Field(default=1, description="version of the profile's format")
    name: str = Field(min_length=1, max_length=64)
    """Name of this robot in messages and files."""
    delay_v_s: float | None = _Delay
    """Delay from a command's arrival at the base until the speed begins to change."""
    delay_omega_s: float | None = _Delay
    """Delay from a command's arrival at the base until the turn rate begins to change."""
    accel: float | None = Field(default=None, ge=0.001, le=1000, description="m/s², true")
    decel: float | None = Field(
        default=None,
        ge=0.001,
        le=1000,
        description="m/s², true, while braking; None: in the description's ratio to accel",
    )
    alpha: float | None = Field(default=None, ge=0.001, le=1000, description="rad/s², true")
    alpha_decel: float | None = Field(
        default=None, ge=0.001, le=1000, description="rad/s², true, while braking"
    )
    gain_v: float | None = _Factor
    """Speed over commanded speed, as odometry reports it."""
    gain_omega: float | None = _Factor
    """Turn rate over commanded turn rate, as odometry reports it."""
    dead_band_v: float | None = Field(default=None, ge=0, le=0.5)
    """Least speed command that the robot follows, m/s; 0: it follows all."""
    dead_band_omega: float | None = Field(default=None, ge=0, le=2)
    """Least turn command that the robot follows, rad/s; 0: it follows all."""
    odometry_distance: float | None = _Factor
    """Distance by odometry over true distance."""
    odometry_heading: float | None = _Factor
    """Turn by odometry over true turn."""
    rotation_center_m: float | None = Field(default=None, ge=-0.5, le=0.5)
    """Lateral velocity over turn rate: the rover turns about a point so far behind its middle."""
    rotation_center_left_m: float | None = Field(default=None, ge=-0.5, le=0.5)
    """Speed that no encoder measures over turn rate: the rover turns about a point so far to the left."""
    wheel_mismatch_rad_m: float | None = Field(default=None, ge=-10, le=10)
    """Wheel mismatch: turn per distance that no encoder measures, rad/m."""
    turn_asymmetry: float | None = Field(default=None, ge=-0.5, le=0.5)
    """On a slope: turn to the left that no encoder measures, per turned angle."""
    downhill_x_m: float | None = Field(default=None, ge=-0.5, le=0.5)
    """On a slope: slide per turned angle (m/rad), along the heading at the start."""
    downhill_y_m: float | None = Field(default=None, ge=-0.5, le=0.5)
    """On a slope: slide per turned angle (m/rad), to the left of the heading at the start."""
    slip_s: float | None = Field(default=None, ge=0, le=10)
    """Share of a turn lost to slip, which no encoder measures, per rad/s."""
    drift_rad_s: float | None = Field(default=None, ge=-10, le=10)
    """Drift of odometry's heading."""
    noise_m: float | None = Field(default=None, ge=0, le=10)
    """Standard deviation of reported positions, beyond their rounding."""
    noise_rad: float | None = Field(default=None, ge=0, le=10)
    """Standard deviation of reported headings, beyond their rounding."""
    std: dict[str, Annotated[float, Field(ge=0)]] = Field(default_factory=dict)
    """Standard deviation of each value above that was fitted, by its name and in its unit."""
    measured: dict[str, Any] = Field(default_factory=dict)
    """Origin of the values: program, recordings, quality of the fit."""


OF_THE_GROUND = "turn_asymmetry", "downhill_x_m", "downhill_y_m"
"""Values of a profile that hold where it was measured, for a rover that starts in the same direction."""


def load_profile(path: str | Path) -> RoverProfile:
    """Load a profile by path. Raises FileError or ConfigError."""
    return load_yaml(Path(path), RoverProfile)
