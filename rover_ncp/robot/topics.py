"""The ROS 2 topics of a robot description."""

import math
from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from rover_ncp.core.config import StrictModel

TopicName = Annotated[str, Field(pattern=r"^[A-Za-z_]\w*(/[A-Za-z_]\w*)*$")]
FrameName = Annotated[str, Field(max_length=200)]


class HazardTopic(StrictModel):
    """A topic that reports hazards, and how its silence is noticed. A name alone has a period of 1 s."""

    topic: TopicName
    """The topic's name."""
    periodic_s: float | None = Field(default=None, ge=0.01, le=5)
    """Longest time between two messages; three times that without one is a hazard. None = 1, or `latched`."""
    latched: bool = False
    """Published at changes only, reliably and transient local; a publisher that is gone is a hazard."""

    @model_validator(mode="before")
    @classmethod
    def _of_name(cls, value: Any) -> Any:
        return {"topic": value} if isinstance(value, str) else value

    @model_validator(mode="after")
    def _is_one_of_both(self) -> Self:
        if self.latched and self.periodic_s is not None:
            raise ValueError("either periodic_s or latched: a topic with a period needs no latch")
        return self

    @property
    def max_silence_s(self) -> float:
        """Longest time without a message; infinite for a latched topic."""
        return math.inf if self.latched else 3.0 * (self.periodic_s or 1.0)


class Topics(StrictModel):
    """ROS 2 topics without a leading slash; None = the robot has none."""

    odom: TopicName = "odom"
    """nav_msgs/Odometry."""
    cmd_vel: TopicName = "cmd_vel"
    """Topic of the commands."""
    cmd_vel_type: Literal["Twist", "TwistStamped"] = "Twist"
    """Type of the commands, of geometry_msgs."""
    imu: TopicName | None = None
    """sensor_msgs/Imu."""
    battery_state: TopicName | None = None
    """sensor_msgs/BatteryState."""
    scan: TopicName | None = None
    """sensor_msgs/LaserScan; needs the section `scan`."""
    stop: HazardTopic | None = None
    """std_msgs/Bool, true while an emergency stop is pressed."""
    hazards: HazardTopic | None = None
    """irobot_create_msgs/HazardDetectionVector: bumps, cliffs, stalls and wheels in the air."""
    docked: TopicName | None = None
    """Says whether the robot is docked, again and again; for the proof `topic` of a place."""
    docked_field: Literal["data", "is_docked"] = "data"
    """Its field: `data` of std_msgs/Bool, or `is_docked` of irobot_create_msgs/DockStatus."""
    pose: TopicName | None = None
    """Pose by the robot's own localiser, passed on to drivers as `pose`; the frame must be the place's."""
    pose_type: Literal["PoseWithCovarianceStamped", "PoseStamped"] = "PoseWithCovarianceStamped"
    """Type of that topic, of geometry_msgs."""
    odom_frame: FrameName = "odom"
    """frame_id of the odometry, of which the part behind the last slash counts; an empty one fits always."""
    base_frame: FrameName = "base_link"
    """child_frame_id of the odometry, by the same rule, and frame_id of the commands."""
    cmd_vel_timeout_s: float | None = Field(default=None, ge=0.01, le=10)
    """Vendor's figure for the base timeout: the mock halts after it. The bridge does not rely on it."""

    @model_validator(mode="after")
    def _are_distinct(self) -> Self:
        uses: dict[str, str] = {}
        for use in ("odom", "cmd_vel", "imu", "battery_state", "scan", "stop", "hazards", "docked", "pose"):
            found = getattr(self, use)
            topic = found.topic if isinstance(found, HazardTopic) else found
            if topic is not None and uses.setdefault(topic, use) != use:
                raise ValueError(f"{uses[topic]} and {use} are both the topic {topic}, expected one for each")
        return self
