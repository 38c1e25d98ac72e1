"""The result of a docking; names are those of opennav_docking_msgs/DockRobot where there is one."""

import math
from enum import IntEnum, StrEnum
from typing import NamedTuple

from pydantic import BaseModel, Field

DOCK_TOPIC = "deploy/dock"
"""Topic of a recording, with the `DockResult` as JSON."""


class Stage(StrEnum):
    """Stage of a docking, by the names of DockRobot's feedback."""

    NONE = "NONE"
    NAV_TO_STAGING_POSE = "NAV_TO_STAGING_POSE"
    CONTROLLING = "CONTROLLING"
    """On the straight approach, or backing out of the place."""
    WAIT_FOR_CHARGE = "WAIT_FOR_CHARGE"
    RETRY = "RETRY"
    """On the way back to the staging pose after a miss."""


class DockError(IntEnum):
    """Error codes of DockRobot's result."""

    NONE = 0
    FAILED_TO_STAGE = 903
    FAILED_TO_DETECT_DOCK = 904
    FAILED_TO_CONTROL = 905
    FAILED_TO_CHARGE = 906
    UNKNOWN = 999


class Evidence(NamedTuple):
    """What the base reports beside its motion."""

    contact: bool = False
    """A bumper or a stall revoked the lease since the last tick, or a bumper was pressed at the first one."""
    docked: bool | None = None
    """Whether the place's proof is there by the newest report, of a charge or on a topic; None = unknown."""
    reports: int = 0
    """Number of such reports so far."""


class PoseErrors(BaseModel):
    """A pose of the rover minus that of the place, in the place's axes."""

    longitudinal_m: float = Field(description="ahead of the place, in its heading")
    lateral_m: float = Field(description="to the left of it")
    yaw_rad: float = Field(description="turned to the left")

    def __str__(self) -> str:
        return (
            f"{1000 * self.longitudinal_m:+.0f} mm ahead, {1000 * self.lateral_m:+.0f} mm to the left and "
            f"{math.degrees(self.yaw_rad):+.1f}°"
        )


class DockResult(BaseModel):
    """How a docking or an undocking ended."""

    place: str = Field(description="its name")
    undock: bool = Field(description="whether the rover was to leave the place")
    success: bool = Field(description="docked, by the place's proof; of an undocking: at the staging pose")
    error_code: int = Field(
        description="DockRobot's: 0, 903 stage, 904 no pose, 905 control, 906 charge, 999"
    )
    error_msg: str = Field(description="why not, in words")
    num_retries: int = Field(description="tries after the first")
    stage: Stage = Field(description="the last stage")
    at: str = Field(description="where the rover stands: place, staging pose, or elsewhere")
    proof: str = Field(description="that the place asks for: pose, charging or topic")
    probability: float | None = Field(
        description="that the rover is within the tolerances, by the estimate at the end of the last approach"
    )
    by_estimate: PoseErrors | None = Field(description="by the estimate at the end of the last approach")
    by_proof: PoseErrors | None = Field(
        description="by the external poses alone at that time: their median while the rover stood"
    )

    @property
    def headline(self) -> str:
        """Whether it succeeded, and why not."""
        what = f"undocked from {self.place}" if self.undock else f"docked at {self.place}"
        return what if self.success else f"not {what}: {self.error_msg}"

    def __str__(self) -> str:
        words = [self.headline]
        if self.num_retries:
            words.append(f"{self.num_retries + 1} tries")
        for by, errors in (("the estimate", self.by_estimate), ("the external poses alone", self.by_proof)):
            if errors is not None:
                words.append(f"by {by} {errors}")
        return "; ".join([*words, f"proof: {self.proof}", f"the rover stands at {self.at}"])
