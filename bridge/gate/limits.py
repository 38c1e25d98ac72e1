"""Limits of the safety gate, from a YAML file or the defaults.

Bounds keep a mistake in the file from undoing the first safety requirement: a rover that receives nothing
stands still within 0.5 s plus braking.
"""

from typing import Self

from pydantic import Field

from rover_ncp.core.config import StrictModel
from rover_ncp.robot.description import RobotDescription
from rover_ncp.wire.protocol import Fence


class Limits(StrictModel):
    """SI units: m/s, rad/s, m/s², rad/s², s, V.

    The accelerations bound how fast the command may grow; braking is never slowed. They lie above those that
    the bridge sets in the base (0.31 and 1.25), which shape the motion that circuits are trained for.
    """

    v_max: float = Field(default=0.3, ge=0.01, le=1.2)
    omega_max: float = Field(default=0.6, ge=0.01, le=3.0)
    accel: float = Field(default=1.0, ge=0.01, le=5.0)
    alpha: float = Field(default=4.0, ge=0.01, le=20.0)
    brake: float = Field(default=0.3, ge=0.01, le=5.0)
    """The least deceleration of the base; the fence assumes it."""
    fence: Fence | None = None
    sonar_stop_m: float | None = Field(default=None, ge=0.01, le=5)
    """The least sonar range, or room by a laser, in the commanded direction; None = no such check.

    Measured from the sonars, which sit up to 7 cm (3-AT) behind the bumper. Sonars do not detect glass, a
    thin leg or the edge of a table.
    """
    command_timeout_s: float = Field(default=0.3, ge=0.05, le=0.4)
    """A command is in force for this long after it was sent. The base's own delay comes on top."""
    stale_s: float = Field(default=0.2, ge=0.01, le=0.3)
    """The gate drops a signed command that is older than this on arrival; one of plain ROS, above 0.3 s."""
    odometry_s: float = Field(default=0.35, ge=0.05, le=0.45)
    """The gate holds the rover when odometry is older than this: three SIPs of 0.1 s may be lost."""
    speed_mean_s: float = Field(default=0.0, ge=0, le=10)
    """The base reports speeds as means over so many seconds; 0: of the moment."""
    lease_s: float = Field(default=1.0, ge=0.1, le=5.0)
    """A lease ends this long after the last accepted command or renewal."""
    battery_min_v: float = Field(default=11.0, ge=0, le=1000)
    """Pioneer manual: charge below 12 V; the base's own alarm comes at 11.5 V, damage below 11 V."""
    battery_low_s: float = Field(default=2.0, ge=0, le=60)
    """How long the voltage must be low: it sags when the motors start."""

    def within(self, robot: RobotDescription) -> Self:
        """Return the tighter of these limits and the robot's own.

        A voltage and a time of mean speeds that are not set here are the robot's.
        """
        motion, given = robot.motion, self.model_fields_set
        battery_min_v = self.battery_min_v if "battery_min_v" in given else 0.0
        mean_s = robot.odometry.speed_mean_s
        chosen = {
            "v_max": min(self.v_max, motion.v_max),
            "omega_max": min(self.omega_max, motion.omega_max),
            "brake": min(self.brake, motion.decel),
            "battery_min_v": max(robot.battery.min_v, battery_min_v),
            "speed_mean_s": min(mean_s, self.speed_mean_s) if "speed_mean_s" in given else mean_s,
        }
        return self.model_copy(update=chosen)
