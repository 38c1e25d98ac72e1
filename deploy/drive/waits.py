"""How long a driver waits for what it needs, and how old odometry may be."""

from pydantic import Field

from rover_ncp.core.config import StrictModel


class Waits(StrictModel):
    """Times in s."""

    bridge_wait_s: float = Field(default=5.0, gt=0, description="for the bridge to show itself")
    permission_wait_s: float = Field(default=2.0, gt=0, description="for the bridge to want our commands")
    odometry_wait_s: float = Field(default=5.0, gt=0, description="for the first odometry")
    odometry_age_s: float = Field(default=0.4, gt=0, le=0.5, description="older odometry stops the rover")
    lease_wait_s: float = Field(default=1.0, gt=0, description="for the gate to confirm our lease")
